// Signs of every plane, see `learned_error_bar.py`: how far the surface before it scattered, and the share of it that
// contradicts it.

@group(0) @binding(0) var<storage, read> sums: array<vec4f>;  // (planes, parts), see `plane_sums.wgsl`
@group(0) @binding(1) var<storage, read_write> signs: array<vec2f>;  // (planes,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let k = invocation(group, groups, local);
    if (k >= planes) { return; }
    var sum = vec4f();
    for (var part = 0u; part < parts; part++) { sum += sums[k * parts + part]; }
    let area = max(sum.z, 1.0);
    signs[k] = vec2f(log(sqrt(sum.x / area) + 0.05), sum.y / area);
}
