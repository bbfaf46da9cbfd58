// What a plane costs a grid point before lines are heard: nothing where it is possible, else all; see
// `plane_edges.py`. Possible are the point's own plane, and next to a border between near and far the other.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // of grid points: a, b, c in layers
@group(0) @binding(2) var<storage, read> plane_count: array<u32>;
@group(0) @binding(3) var<storage, read> meeting: array<u32>;  // (planes, planes)
@group(0) @binding(4) var<storage, read> inside: array<f32>;  // (h, w)
@group(0) @binding(5) var<storage, read_write> cost: array<f32>;  // (h, w, planes)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let number = plane_count[0];
    let own = choice[i];
    for (var k = 0u; k < number; k++) { cost[i * number + k] = forbidden; }
    cost[i * number + own] = 0.0;
    if (inside[i] > f32(around)) { return; }
    let y = i32(i / width);
    let x = i32(i % width);
    let far = i32(around);
    let low = vec2i(max(y - far, 0i), max(x - far, 0i));
    let high = vec2i(min(y + far, i32(height) - 1i), min(x + far, i32(width) - 1i));
    var half_width = 0.0;
    for (var v = low.x; v <= high.x; v++) {
        for (var u = low.y; u <= high.y; u++) {
            let at = u32(v) * width + u32(u);
            let is_own = choice[at] == own && max(abs(v - y), abs(u - x)) <= i32(floor(reach));
            half_width = max(half_width, select(0.0, inside[at], is_own));
        }
    }
    let stays = inside[i] >= core * half_width && half_width < reach;  // the core of a thin plane
    let terms = vec4f(f32(x), f32(y), 1.0, 0.0);
    let own_label = dot(planes[own], terms);
    for (var v = low.x; v <= high.x; v++) {
        for (var u = low.y; u <= high.y; u++) {
            let other = choice[u32(v) * width + u32(u)];
            if (other == own || meeting[own * number + other] == 0u) { continue; }
            let beyond = dot(planes[other], terms) - own_label;  // labels grow with distance
            let away = chamfer(v - y, u - x);
            if ((beyond > apart && away <= reach && !stays) || (-beyond > apart && away <= outward)) {
                cost[i * number + other] = 0.0;
            }
        }
    }
}
