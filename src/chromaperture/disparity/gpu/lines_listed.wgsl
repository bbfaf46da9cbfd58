// Lists the lines across borders, in the order of their grid points, with what the covariances of both sides depend on.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // of grid points: a, b, c in layers
@group(0) @binding(2) var<storage, read> before: array<u32>;  // of workgroups: lines of those before
@group(0) @binding(3) var<storage, read> maps: array<vec4f>;  // (h, w): layer of the blur at label 0, of one label; node
@group(0) @binding(4) var<storage, read_write> line_at: array<u32>;  // (2, h, w): 1 where there is one; then 1 + line
@group(0) @binding(5) var<storage, read_write> about: array<vec4u>;  // near and far plane, points and order, weight
@group(0) @binding(6) var<storage, read_write> lines: array<vec2u>;  // grid point, and the sides' key

var<workgroup> found: array<u32, 64>;

fn layer(plane: vec4f, point: u32) -> u32 {
    let label = dot(plane, vec4f(f32(point % width), f32(point / width), 1.0, 0.0));
    let at = round(maps[point].x + maps[point].y * label) - first_layer;
    return u32(clamp(at, 0.0, f32(layers - 1u)));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    var own = 0u;
    if (i < 2u * width * height) { own = line_at[i]; }
    found[local] = own;
    workgroupBarrier();
    if (own == 0u) { return; }
    var line = before[group.x + group.y * groups.x];
    for (var k = 0u; k < local; k++) { line += found[k]; }
    if (line >= most) {
        line_at[i] = 0u;
        return;
    }
    line_at[i] = 1u + line;
    let border = border_at(i);
    let down = i >= width * height;
    let point = select(i, i - width * height, down);
    about[line] = vec4u(border.near, border.far, border.of_pair | select(0u, 1u << 31u, border.near_first), 0u);
    let node = u32(maps[point].z);
    let order = select(0u, 1u, border.near_first) + select(0u, 2u, down);
    let key = (order * nodes + node) * layers + layer(planes[border.near], point);
    lines[line] = vec2u(i, key * layers + layer(planes[border.far], point));
}
