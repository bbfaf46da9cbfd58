// How far the next step between planes is along a row, up to `reach` px; beyond, reach + 1.

@group(0) @binding(0) var<storage, read> steps: array<u32>;  // (h, w): 1 where there is one
@group(0) @binding(1) var<storage, read_write> away: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i % width;
    var least = reach + 1u;
    for (var u = max(x, reach) - reach; u <= min(x + reach, width - 1u); u++) {
        let distance = max(u, x) - min(u, x);
        least = min(least, select(reach + 1u, distance, steps[i + u - x] == 1u));
    }
    away[i] = least;
}
