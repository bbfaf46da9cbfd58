// Lists the pairs of planes that meet. Their order does not matter.

@group(0) @binding(0) var<storage, read> meeting: array<u32>;  // (planes, planes): 1 where they meet
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> joins: array<atomic<u32>>;  // `Join` of `pair_fit.wgsl`, 12 numbers each

const slots = 9u;  // the place of both planes in a `Join`; of the first how many follow

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let number = plane_count[0];
    if (number < 2u || i >= number * number || i / number >= i % number || meeting[i] == 0u) { return; }
    let at = 1u + atomicAdd(&joins[slots], 1u);
    atomicStore(&joins[12u * at + slots], (i / number) | ((i % number) << 16u));
}
