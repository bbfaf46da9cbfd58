// Keeps the planes that a fit has found and the choice of its blocks, behind those of the fits before.

@group(0) @binding(0) var<storage, read> planes: array<vec4f>;  // (capacity,): layers, of blocks
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read> choice: array<u32>;  // (blocks,)
@group(0) @binding(3) var<storage, read_write> kept: array<vec4f>;  // (fits, capacity) at most, without gaps
@group(0) @binding(4) var<storage, read_write> firsts: array<u32>;  // (fits + 1,): where each fit's planes begin
@group(0) @binding(5) var<storage, read_write> choices: array<u32>;  // (fits, blocks): planes of `kept`
@group(0) @binding(6) var<storage, read_write> number: array<u32>;  // of planes that are kept

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    var first = 0u;
    if (fit > 0u) { first = firsts[fit]; }
    if (i == 0u) {
        firsts[fit + 1u] = first + plane_count[0];
        number[0] = first + plane_count[0];
    }
    if (i < plane_count[0]) { kept[first + i] = planes[i]; }
    if (i < blocks) { choices[fit * blocks + i] = first + choice[i]; }
}
