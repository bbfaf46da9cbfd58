// Sets to 0 what the joining of planes counts up: blocks of planes, pairs, which planes meet.

@group(0) @binding(0) var<storage, read> plane_count: array<u32>;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;  // (capacity, 2)
@group(0) @binding(2) var<storage, read_write> joins: array<vec4u>;  // the first three: how many there are
@group(0) @binding(3) var<storage, read_write> meeting: array<u32>;  // (planes, planes)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i < 2u * capacity) { counts[i] = 0u; }
    if (i < 3u) { joins[i] = vec4u(); }
    if (i < plane_count[0] * plane_count[0]) { meeting[i] = 0u; }
}
