// Signs of every plane, see `learned_error_bar.py`: how far the surface before it scattered, the share of it that
// contradicts it, and whether it is known, see `plane_agreement.known_planes`.

@group(0) @binding(0) var<storage, read> sums: array<vec4f>;  // (planes, parts, 2)
@group(0) @binding(1) var<storage, read_write> signs: array<vec4f>;  // (planes,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let k = invocation(group, groups, local);
    if (k >= planes) { return; }
    var counts = vec4f();
    var others = vec4f();
    for (var part = 0u; part < parts; part++) {
        counts += sums[2u * (k * parts + part)];
        others += sums[2u * (k * parts + part) + 1u];
    }
    let area = max(counts.z, 1.0);
    let share = select(counts.w / area, counts.y / max(counts.x, 1.0), counts.x > 0.0);
    signs[k] = vec4f(log(sqrt(others.x / area) + 0.05), others.y / area, select(0.0, 1.0, share >= known_share), 0.0);
}
