// Light divided by coverage, not negative.

@group(0) @binding(0) var<storage, read> total: array<vec4f>;  // (H, W)
@group(0) @binding(1) var<storage, read_write> refocused: array<f32>;  // (H, W, 3)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pixels) { return; }
    let light = max(total[i].xyz / max(total[i].w, least_cover), vec3f());
    refocused[3u * i] = light.x;
    refocused[3u * i + 1u] = light.y;
    refocused[3u * i + 2u] = light.z;
}
