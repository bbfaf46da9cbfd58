// The distinct planes in the coordinates of blocks, as those that blocks choose from; see `planar.py`.

@group(0) @binding(0) var<storage, read> kept: array<u32>;  // how many, then their slots
@group(0) @binding(1) var<storage, read> found: array<vec4f>;  // (slots,): layers, from the middle of their points
@group(0) @binding(2) var<storage, read> parts: array<vec4u>;  // (slots,): the middle as bits last
@group(0) @binding(3) var<storage, read_write> planes: array<vec4f>;  // (planes,): a, b, c in layers, cost of the slope
@group(0) @binding(4) var<storage, read_write> plane_count: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i == 0u) { plane_count[0] = kept[0]; }
    if (i >= kept[0]) { return; }
    let plane = found[kept[i + 1u]].xyz;
    let middle = bitcast<vec2f>(parts[kept[i + 1u]].zw);
    let slope = plane.xy * f32(block);
    let first = vec2f(0.5 * f32(block - 1u));  // middle of the first block
    planes[i] = vec4f(slope, plane.z + dot(plane.xy, first - middle), 0.5 * slope_penalty * dot(slope, slope));
}
