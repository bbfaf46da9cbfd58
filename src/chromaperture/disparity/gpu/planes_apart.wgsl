// Where planes and the surface that they explain differ by more than its error bar; see `plane_agreement.py`.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // a, b, c in layers
@group(0) @binding(2) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(3) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(4) var<storage, read_write> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(5) var<storage, read_write> apart: array<u32>;  // (h, w): 1 where they do

@group(0) @binding(6) var<storage, read_write> first: array<f32>;  // (h, w): layer of the surface, for later

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    there[i] = dot(planes[choice[i]], vec4f(f32(i % width), f32(i / width), 1.0, 0.0));
    first[i] = surface[i].x;
    let bar = sqrt(sigma[i] * sigma[i] + 1.0);  // with a label's own place
    apart[i] = select(0u, 1u, abs(there[i] - surface[i].x) > sigmas * bar);
}
