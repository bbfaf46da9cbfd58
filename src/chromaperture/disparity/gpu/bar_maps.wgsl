// What is averaged for the error bar: the posterior's variance, and where the surface before contradicts its plane.

@group(0) @binding(0) var<storage, read> first: array<f32>;  // (h, w): layer of the surface before
@group(0) @binding(1) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(2) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(3) var<storage, read_write> pooled: array<vec2f>;  // (h, w): both
@group(0) @binding(4) var<storage, read_write> wide: array<f32>;  // (h, w): the second

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    wide[i] = select(0.0, 1.0, abs(first[i] - there[i]) > apart);
    pooled[i] = vec2f(sigma[i] * sigma[i], wide[i]);
}
