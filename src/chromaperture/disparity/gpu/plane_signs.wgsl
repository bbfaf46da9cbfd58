// The share of every plane's pixels where the surface before contradicts it; see `learned_error_bar.of_planes`.

@group(0) @binding(0) var<storage, read> sums: array<vec2f>;  // (planes, parts), see `plane_sums.wgsl`
@group(0) @binding(1) var<storage, read_write> rejected: array<f32>;  // (planes,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let k = invocation(group, groups, local);
    if (k >= planes) { return; }
    var sum = vec2f();
    for (var part = 0u; part < parts; part++) { sum += sums[k * parts + part]; }
    rejected[k] = sum.x / max(sum.y, 1.0);
}
