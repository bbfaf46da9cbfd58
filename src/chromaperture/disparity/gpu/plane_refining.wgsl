// Moves planes to the most likely place near them; see `plane_fit.py`. A workgroup has one plane and its points. Planes
// count in layers, from the middle of their points.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read> points: array<u32>;  // x and y, 16 bits each
@group(0) @binding(2) var<storage, read> parts: array<vec4u>;  // (planes,): first point, points; their middle as bits
@group(0) @binding(3) var<storage, read_write> planes: array<vec4f>;  // (planes,)

var<private> part: vec4u;

fn sums_of(plane: vec3f, middle: vec2f, local: u32) -> Sums {
    var own = Sums();
    for (var i = local; i < part.y; i += lanes) {
        let packed = points[part.x + i];
        own = added(own, of_point(plane, vec2u(packed & 0xffffu, packed >> 16u), middle));
    }
    return total(own, local);
}

@compute @workgroup_size(lanes)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (parts[group.x].y == 0u) { return; }
    part = parts[group.x];
    let middle = bitcast<vec2f>(part.zw);
    let found = climbed(planes[group.x].xyz, middle, slope_penalty * f32(parts[group.x].y), newton_steps, false, local);
    if (local == 0u) { planes[group.x] = found; }
}
