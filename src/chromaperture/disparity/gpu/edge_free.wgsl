// Whether more than one plane is possible at a grid point.

@group(0) @binding(0) var<storage, read> cost: array<f32>;  // (points, planes)
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> free: array<u32>;  // (points,): 1 where it is so

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= points) { return; }
    let number = plane_count[0];
    var possible = 0u;
    for (var k = 0u; k < number; k++) { possible += select(0u, 1u, cost[i * number + k] < forbidden / 2.0); }
    free[i] = select(0u, 1u, possible > 1u);
}
