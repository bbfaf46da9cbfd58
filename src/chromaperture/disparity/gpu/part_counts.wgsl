// How many blocks every plane has, and how many of them are its core: no other plane within `border` blocks.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w): plane of every block
@group(0) @binding(1) var<storage, read_write> cores: array<u32>;  // (h, w): 1 in a core
@group(0) @binding(2) var<storage, read_write> counts: array<atomic<u32>>;  // (capacity, 2): all blocks, core; 0 before

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let y = i32(i / width);
    let x = i32(i % width);
    let far = i32(border);
    let own = choice[i];
    var core = 1u;
    for (var v = max(y - far, 0i); v <= min(y + far, i32(height) - 1i); v++) {
        for (var u = max(x - far, 0i); u <= min(x + far, i32(width) - 1i); u++) {
            core &= select(0u, 1u, choice[u32(v) * width + u32(u)] == own);
        }
    }
    cores[i] = core;
    atomicAdd(&counts[2u * own], 1u);
    if (core == 1u) { atomicAdd(&counts[2u * own + 1u], 1u); }
}
