// Leaves out refined planes that agree with one of a larger tile all over their own; see `plane_fit.distinct`. One
// workgroup, one plane after the other, the largest tiles first; all that were kept are compared side by side.

@group(0) @binding(0) var<storage, read> planes: array<vec4f>;  // (slots,): layers, from the middle of their points
@group(0) @binding(1) var<storage, read> parts: array<vec4u>;  // (slots,): points second, their middle as bits
@group(0) @binding(2) var<storage, read> order: array<vec2u>;  // (slots,): slot, side of its tile
@group(0) @binding(3) var<storage, read_write> kept: array<u32>;  // how many, then their slots

var<workgroup> is_alike: array<u32, lanes>;

fn at(slot: u32, place: vec2f) -> f32 {
    return dot(planes[slot].xyz, vec3f(place - bitcast<vec2f>(parts[slot].zw), 1.0));
}

@compute @workgroup_size(lanes)
fn main(@builtin(local_invocation_index) local: u32) {
    var count = 0u;
    for (var i = 0u; i < slots; i++) {
        let slot = order[i].x;
        if (parts[slot].y == 0u) { continue; }
        let middle = bitcast<vec2f>(parts[slot].zw);
        let half_side = 0.5 * f32(order[i].y);
        var alike = 0u;
        for (var k = local; k < count; k += lanes) {
            let other = kept[k + 1u];
            var most = abs(planes[slot].z - at(other, middle));
            for (var c = 0u; c < 4u; c++) {
                let place = middle + half_side * vec2f(select(-1.0, 1.0, c % 2u == 1u), select(-1.0, 1.0, c > 1u));
                most = max(most, abs(at(slot, place) - at(other, place)));
            }
            alike |= select(1u, 0u, most > tolerance);
        }
        is_alike[local] = alike;
        workgroupBarrier();
        var any = 0u;
        for (var k = 0u; k < lanes; k++) { any |= is_alike[k]; }
        if (any == 0u && count < most) {
            if (local == 0u) { kept[count + 1u] = slot; }
            count++;
        }
        storageBarrier();
        workgroupBarrier();
    }
    if (local == 0u) { kept[0] = count; }
}
