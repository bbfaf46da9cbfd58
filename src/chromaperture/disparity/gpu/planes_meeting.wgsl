// Which planes meet at a side of a grid point.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> meeting: array<atomic<u32>>;  // (planes, planes): 1 where they do

fn note(one: u32, other: u32) {
    if (one == other) { return; }
    atomicStore(&meeting[one * plane_count[0] + other], 1u);
    atomicStore(&meeting[other * plane_count[0] + one], 1u);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    if (i % width + 1u < width) { note(choice[i], choice[i + 1u]); }
    if (i + width < width * height) { note(choice[i], choice[i + width]); }
}
