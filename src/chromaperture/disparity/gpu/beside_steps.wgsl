// The pixels within `reach` of a step between planes, as `plane_agreement.beside_borders`: of every row about a pixel it
// is known how far the next step is, and how far the reach goes there.

@group(0) @binding(0) var<storage, read> away: array<u32>;  // (h, w): along the row, see `step_distance.wgsl`
@group(0) @binding(1) var<storage, read_write> beside: array<u32>;  // (h, w): 1 where it is so

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let y = i / width;
    var near = 0u;
    for (var v = max(y, reach) - reach; v <= min(y + reach, height - 1u); v++) {
        near |= select(0u, 1u, away[i + v * width - y * width] <= u32(around[v + reach - y]));
    }
    beside[i] = near;
}
