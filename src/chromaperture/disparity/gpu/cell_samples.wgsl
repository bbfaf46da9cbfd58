// Views read between their pixels, at every sub-pixel phase that the layers use; beyond the picture its border goes on.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (planes, h, w), the views first
@group(0) @binding(1) var<storage, read> entries: array<f32>;  // (E, 9): the view, four taps along x, four along y
@group(0) @binding(2) var<storage, read_write> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let wide = width + 2u * pad_x;
    if (i >= (height + 2u * pad_y) * wide * entry_count) { return; }
    let entry = 9u * (i % entry_count);
    let x = i32((i / entry_count) % wide) - i32(pad_x);
    let y = i32(i / (entry_count * wide)) - i32(pad_y);
    let view = u32(entries[entry]) * width * height;
    var sum = 0.0;
    for (var j = 0u; j < 4u; j++) {
        let row = view + inside(y + i32(j) - 1i, height) * width;
        var along = 0.0;
        for (var k = 0u; k < 4u; k++) { along += entries[entry + 1u + k] * planes[row + inside(x + i32(k) - 1i, width)]; }
        sum += entries[entry + 5u + j] * along;
    }
    samples[i] = sum;
}
