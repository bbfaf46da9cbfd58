// Views, guide and mask, every second column of the picture behind OpenCV's pyramid filter (1, 4, 6, 4, 1) / 16.
// Unusable pixels count 0, which is the mean of the views. The guide at full resolution goes out beside them.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;  // (K + 2, H, w): views, guide, mask
@group(0) @binding(3) var<storage, read_write> full_guide: array<f32>;  // (H, W)

const taps = array<f32, 5>(0.0625, 0.25, 0.375, 0.25, 0.0625);

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= half_width * height) { return; }
    let x = i % half_width;
    let y = i / half_width;
    var views = vec3f();
    var guide = 0.0;
    var usable = 0.0;
    for (var j = 0u; j < 5u; j++) {
        let found = pixel(mirrored(i32(2u * x + j) - 2i, width), y);
        views += taps[j] * found.usable * found.views;
        guide += taps[j] * found.guide;
        usable += taps[j] * found.usable;
        if ((j == 2u || j == 3u) && 2u * x + j - 2u < width) {
            full_guide[y * width + 2u * x + j - 2u] = found.guide;
        }
    }
    let plane = half_width * height;
    for (var k = 0u; k < view_count; k++) { planes[k * plane + i] = views[k]; }
    planes[view_count * plane + i] = guide;
    planes[(view_count + 1u) * plane + i] = usable;
}
