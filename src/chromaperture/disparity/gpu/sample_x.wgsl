// The samples of `sample_y.wgsl` read between their columns: an entry is a view at one phase along x and one along y.

@group(0) @binding(0) var<storage, read> rows: array<f32>;  // (h + 2 pad_y, w, Ey)
@group(0) @binding(1) var<storage, read> phases: array<f32>;  // (E, 5): four taps, the phase along y
@group(0) @binding(2) var<storage, read_write> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let wide = width + 2u * pad_x;
    if (i >= (height + 2u * pad_y) * wide * entry_count) { return; }
    let e = i % entry_count;
    let x = i32((i / entry_count) % wide) - i32(pad_x);
    let row = (i / (entry_count * wide)) * width;
    let phase = u32(phases[5u * e + 4u]);
    var sum = 0.0;
    for (var j = 0u; j < 4u; j++) {
        sum += phases[5u * e + j] * rows[(row + inside(x + i32(j) - 1i, width)) * phase_count + phase];
    }
    samples[i] = sum;
}
