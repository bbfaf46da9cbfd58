// Whether a pixel is known, see `accurate.judged`: where its error bar is short, or where it lies on a known plane. And the
// variance of its posterior.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(2) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(4) var<storage, read> evidence_of: array<vec2f>;  // (planes,): first how much it falls
@group(0) @binding(5) var<storage, read_write> known: array<u32>;  // (h, w)
@group(0) @binding(6) var<storage, read_write> bar: array<u32>;  // (h, w): the plane's number, for `learned_bar.wgsl`
@group(0) @binding(7) var<storage, read_write> variance: array<f32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let u = surface[i].x;
    let on_known = evidence_of[choice[i]].x >= known_from && u == there[i];
    let inside = u > 0.5 && u < f32(count) - 1.5;
    known[i] = select(0u, 1u, inside && (sigma[i] < known_within || on_known));
    bar[i] = choice[i];
    variance[i] = sigma[i] * sigma[i];
}
