// The surface of the cells at every pixel of the halved picture, by `between.wgsl`.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (half_height, half_width)
@group(0) @binding(1) var<storage, read> guide: array<f32>;  // (h, w)
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> enlarged: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    enlarged[i] = vec4f(surface_at(i % width, i / width), 0.0);
}
