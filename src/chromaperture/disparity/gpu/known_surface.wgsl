// Whether a pixel of a surface without planes is known, see `accurate.judged`, and the variance of its posterior.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(2) var<storage, read_write> known: array<u32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> variance: array<f32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let u = surface[i].x;
    known[i] = select(0u, 1u, u > 0.5 && u < f32(count) - 1.5 && sigma[i] < known_within);
    variance[i] = sigma[i] * sigma[i];
}
