// The planes that blocks chose, in the coordinates of pixels and of grid points; as many as there is room for.

@group(0) @binding(0) var<storage, read> planes: array<vec4f>;  // a, b, c in layers, of blocks
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> of_pixels: array<vec4f>;  // (most,)
@group(0) @binding(3) var<storage, read_write> of_points: array<vec4f>;  // (most,)
@group(0) @binding(4) var<storage, read_write> kept: array<u32>;  // how many
@group(0) @binding(5) var<storage, read_write> unfinished: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let k = invocation(group, groups, local);
    if (k == 0u) {
        kept[0] = min(plane_count[0], most);
        if (plane_count[0] > most) { unfinished[0]++; }
    }
    if (k >= most) { return; }
    let slope = planes[k].xy / f32(block);
    let middle = 0.5 * f32(block - 1u);  // of the first block, px
    let plane = vec4f(slope, planes[k].z - (slope.x + slope.y) * middle, 0.0);
    of_pixels[k] = plane;
    of_points[k] = plane * vec4f(f32(spacing), f32(spacing), 1.0, 0.0);
}
