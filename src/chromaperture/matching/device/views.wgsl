// Views, guide and mask at full resolution (quality "paper"), as planes.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;  // (K + 2, H, W): views, guide
@group(0) @binding(3) var<storage, read_write> smoothed: array<f32>;  // (K + 2, H, W), of which only the mask

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let found = pixel(i % width, i / width);
    for (var k = 0u; k < view_count; k++) { planes[k * width * height + i] = found.views[k]; }
    planes[view_count * width * height + i] = found.guide;
    smoothed[(view_count + 1u) * width * height + i] = found.usable;
}
