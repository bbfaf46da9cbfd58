// Every pixel as an area of its own, whose number is its place. Pixels of one key are to be joined, see
// `areas_joined.wgsl`; where `of_spots` only those that are set.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> apart: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read_write> keys: array<u32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> areas: array<u32>;  // (h, w)
@group(0) @binding(4) var<storage, read_write> sums: array<u32>;  // (h, w, 2), of areas at their number

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    keys[i] = select(choice[i], 0xffffffffu, of_spots && apart[i] == 0u);
    areas[i] = i;
    sums[2u * i] = 0u;
    sums[2u * i + 1u] = 0u;
}
