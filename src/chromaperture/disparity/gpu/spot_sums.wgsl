// Pixels of every spot of difference, and how many of them touch the border of their area; the frame is none.

@group(0) @binding(0) var<storage, read> areas: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> spots: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read> apart: array<u32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> sums: array<atomic<u32>>;  // (h, w, 2), at a spot's number

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height || apart[i] == 0u) { return; }
    let y = i32(i / width);
    let x = i32(i % width);
    var others = 0u;
    for (var v = max(y - i32(reach), 0i); v <= min(y + i32(reach), i32(height) - 1i); v++) {
        let wide = i32(disc[u32(v - y + i32(reach))]);
        for (var u = max(x - wide, 0i); u <= min(x + wide, i32(width) - 1i); u++) {
            others += select(0u, 1u, areas[u32(v) * width + u32(u)] != areas[i]);
        }
    }
    atomicAdd(&sums[2u * spots[i]], 1u);
    if (others > 0u) { atomicAdd(&sums[2u * spots[i] + 1u], 1u); }
}
