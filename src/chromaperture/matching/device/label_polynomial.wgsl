// Reads a pixel's or a sample's unexplained fractions of all layers at a label; see `layer_polynomial.wgsl`.

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
    let found = through_six(low, place - f32(low));
    let value = max(found, least_unexplained * min(ladder[low + 2u], ladder[low + 3u]));
    return select(1.0, value, place > -edge_layers && place < f32(layers - 1u) + edge_layers);
}
