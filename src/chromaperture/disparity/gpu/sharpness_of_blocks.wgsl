// Gives every block the sharpness of the plane in its middle.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> averages: array<f32>;  // (planes + 1,)
@group(0) @binding(2) var<storage, read_write> signs: array<vec2f>;  // (blocks,): spread, and now the sharpness

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = width / block;
    if (i >= across * (height / block)) { return; }
    let middle = (i / across * block + block / 2u) * width + i % across * block + block / 2u;
    signs[i].y = averages[choice[middle]];
}
