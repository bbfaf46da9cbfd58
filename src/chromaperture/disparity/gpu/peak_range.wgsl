// The error bar of a peak, widened where the disparity varies around it (quality "paper"), as `paper.py`.

@group(0) @binding(0) var<storage, read> peaks: array<f32>;  // (3, H, W): disparity, its error bar, score
@group(0) @binding(1) var<storage, read> ranges: array<vec2f>;  // (H, W): lowest and highest disparity along x
@group(0) @binding(2) var<storage, read_write> disparity: array<u32>;  // (H, W)
@group(0) @binding(3) var<storage, read_write> sigma: array<u32>;
@group(0) @binding(4) var<storage, read_write> confidence: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let pixels = width * height;
    if (i >= pixels) { return; }
    let x = i % width;
    let y = i32(i / width);
    var low = 1.0e30;
    var high = -1.0e30;
    for (var n = 0u; n < side; n++) {  // unrolled
        let here = ranges[inside(y + i32(n) - i32(reach), height) * width + x];
        low = min(low, here.x);
        high = max(high, here.y);
    }
    let at_edge = edge_share * max(high - low, 0.0);
    let wide = min(length(vec3f(peaks[pixels + i], at_edge, floor_px)), range_sigma_px);
    let maps = finished(i, peaks[i], wide, peaks[2u * pixels + i], 0.0);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
