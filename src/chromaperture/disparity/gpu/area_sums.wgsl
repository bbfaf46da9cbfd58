// Pixels of every area, and how many of them differ.

@group(0) @binding(0) var<storage, read> found: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> apart: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read_write> sums: array<atomic<u32>>;  // (h, w, 2), at an area's number

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    // 16 neighbours are of one area almost everywhere: they are counted before they are added.
    let first = 16u * invocation(group, groups, local);
    var area = 0xffffffffu;
    var size = 0u;
    var differing = 0u;
    for (var i = first; i < min(first + 16u, width * height); i++) {
        if (found[i] != area) {
            if (size > 0u) {
                atomicAdd(&sums[2u * area], size);
                atomicAdd(&sums[2u * area + 1u], differing);
            }
            area = found[i];
            size = 0u;
            differing = 0u;
        }
        size += 1u;
        differing += apart[i];
    }
    if (size > 0u) {
        atomicAdd(&sums[2u * area], size);
        atomicAdd(&sums[2u * area + 1u], differing);
    }
}
