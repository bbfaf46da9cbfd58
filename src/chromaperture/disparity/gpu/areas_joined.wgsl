// Joins the areas of neighbours at a side whose keys are the same: an area is known by its lowest pixel, to which every
// pixel leads over lower and lower ones. Whatever the order of the invocations, the areas are the same in the end.

@group(0) @binding(0) var<storage, read> keys: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> areas: array<atomic<u32>>;  // (h, w)

fn lowest(start: u32) -> u32 {
    var at = start;
    var next = atomicLoad(&areas[at]);
    while (next != at) {
        at = next;
        next = atomicLoad(&areas[at]);
    }
    return at;
}

fn join(one: u32, other: u32) {
    var a = lowest(one);
    var b = lowest(other);
    while (a != b) {
        let high = max(a, b);
        let low = min(a, b);
        let found = atomicMin(&areas[high], low);
        if (found == high) { return; }
        // Another invocation was first: what it leads to is to be joined, too.
        a = lowest(found);
        b = lowest(low);
    }
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height || keys[i] == 0xffffffffu) { return; }
    let to_left = i % width > 0u && keys[max(i, 1u) - 1u] == keys[i];
    let upwards = i >= width && keys[max(i, width) - width] == keys[i];
    if (to_left) { join(i, i - 1u); }
    // Where the pixel above and both at the left are of the area, the left one has joined the upper row.
    if (upwards && !(to_left && keys[i - width - 1u] == keys[i])) { join(i, i - width); }
}
