// Reads a pixel's or a sample's unexplained fractions of all layers, `ladder`, at a label: a polynomial through six layers.

var<workgroup> ladder: array<f32, layers + 4u>;  // from its third number on

// A straight continuation at both ends; every invocation calls it.
fn continue_ladder(local: u32) {
    workgroupBarrier();
    if (local == 0u) {
        ladder[1] = 2.0 * ladder[2] - ladder[3];
        ladder[0] = 2.0 * ladder[1] - ladder[2];
        ladder[layers + 2u] = 2.0 * ladder[layers + 1u] - ladder[layers];
        ladder[layers + 3u] = 2.0 * ladder[layers + 2u] - ladder[layers + 1u];
    }
    workgroupBarrier();
}

// At a place in layers from the first; 1, no evidence, beyond all layers.
fn unexplained_at(place: f32) -> f32 {
    let low = u32(clamp(floor(place), 0.0, f32(layers - 2u)));
    let t = place - f32(low);
    let a = t + 2.0;
    let b = t + 1.0;
    let c = t - 1.0;
    let d = t - 2.0;
    let e = t - 3.0;
    let between = a * e * (t * b * d * ladder[low + 3u] - b * c * d * ladder[low + 2u]) / 12.0;
    let beside = t * c * a * e * (d * ladder[low + 1u] - b * ladder[low + 4u]) / 24.0;
    let outer = b * t * c * d * (a * ladder[low + 5u] - e * ladder[low]) / 120.0;
    let value = max(between + beside + outer, least_unexplained * min(ladder[low + 2u], ladder[low + 3u]));
    return select(1.0, value, place > -edge_layers && place < f32(layers - 1u) + edge_layers);
}
