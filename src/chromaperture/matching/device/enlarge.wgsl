// The surface of the halved picture at every pixel, by `between.wgsl`.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing
@group(0) @binding(1) var<storage, read> guide: array<f32>;  // (H, W)
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read> labels: array<f32>;  // (2, H, W) or (2, 1, 1)
@group(0) @binding(4) var<storage, read> lacking: array<f32>;  // (cells_y, cells_x)
@group(0) @binding(5) var<storage, read_write> disparity: array<u32>;  // (H, W)
@group(0) @binding(6) var<storage, read_write> sigma: array<u32>;
@group(0) @binding(7) var<storage, read_write> confidence: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    let found = surface_at(x, y);
    var least_sigma = 0.0;
    if (lacking[(y * cells_y / height) * cells_x + x * cells_x / width] > 0.0) {
        var scale = 1.0;
        if (labelled) { scale = labels[width * height + i]; }
        least_sigma = min(scale * range_sigma_px, max_sigma_px);
    }
    let maps = finished(i, found.x, length(vec2f(found.y, floor_px)), found.z, least_sigma);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
