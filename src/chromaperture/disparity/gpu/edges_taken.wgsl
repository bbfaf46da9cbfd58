// The plane of every pixel: that of its grid point where more than one was possible there, else that of its block.

@group(0) @binding(0) var<storage, read> blocks: array<u32>;
@group(0) @binding(1) var<storage, read> moved: array<u32>;  // (points): choice of least belief
@group(0) @binding(2) var<storage, read> free: array<u32>;  // (points)
@group(0) @binding(3) var<storage, read_write> choice: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let y = i / width;
    let x = i % width;
    let point = y / spacing * ((width + spacing - 1u) / spacing) + x / spacing;
    choice[i] = select(blocks[block_at(y, x)], moved[point], free[point] == 1u);
}
