// The number of every pixel's area, the lowest pixel of it.

@group(0) @binding(0) var<storage, read> areas: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> found: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    var at = i;
    while (areas[at] != at) { at = areas[at]; }
    found[i] = at;
}
