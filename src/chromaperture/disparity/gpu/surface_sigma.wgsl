// Root mean square distance of the layers from a map, by the mean and the variance of their posterior; layers. The map
// goes by itself to where it can be read back.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read> posterior: array<vec2f>;  // (h, w)
@group(0) @binding(2) var<storage, read_write> sigma: array<f32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> label: array<f32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let away = surface[pixel].x - posterior[pixel].x;
    label[pixel] = surface[pixel].x;
    sigma[pixel] = sqrt(posterior[pixel].y + away * away);
}
