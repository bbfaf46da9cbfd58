// What is averaged for the trust in planes, see `plane_trust.py`: the posterior's variance, where the surface allows its
// plane, and how far it lies from its neighbours.

@group(0) @binding(0) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(1) var<storage, read> agreed: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read> first: array<f32>;  // (h, w): layer of the surface
@group(0) @binding(3) var<storage, read_write> pooled: array<vec2f>;  // (h, w): variance, 1 where allowed
@group(0) @binding(4) var<storage, read_write> steps: array<f32>;  // (h, w), layers

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    pooled[i] = vec2f(sigma[i] * sigma[i], f32(agreed[i]));
    let right = select(i, i + 1u, i % width + 1u < width);
    let below = select(i, i + width, i + width < width * height);
    steps[i] = min(abs(first[right] - first[i]) + abs(first[below] - first[i]), most_difference);
}
