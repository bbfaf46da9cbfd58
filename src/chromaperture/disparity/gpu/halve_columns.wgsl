// Every second row of the planes behind the pyramid filter.

@group(0) @binding(0) var<storage, read> tall: array<f32>;  // (planes, H, w)
@group(0) @binding(1) var<storage, read_write> planes: array<f32>;  // (planes, h, w)

const taps = array<f32, 5>(0.0625, 0.25, 0.375, 0.25, 0.0625);

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= plane_count * width * height) { return; }
    let x = i % width;
    let y = (i / width) % height;
    let plane = i / (width * height);
    var sum = 0.0;
    for (var j = 0u; j < 5u; j++) {
        sum += taps[j] * tall[(plane * tall_height + mirrored(i32(2u * y + j) - 2i, tall_height)) * width + x];
    }
    planes[i] = sum;
}
