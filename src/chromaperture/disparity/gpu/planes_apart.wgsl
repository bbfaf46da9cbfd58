// Where planes and the surface that they explain are further apart than its error bar allows.

@group(0) @binding(0) var<storage, read> plane_labels: array<f32>;  // (h, w), layers
@group(0) @binding(1) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(2) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read_write> apart: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let limit = sigmas * length(vec2f(sigma[pixel], 1.0));
    apart[pixel] = select(0.0, 1.0, abs(plane_labels[pixel] - surface[pixel].x) > limit);
}
