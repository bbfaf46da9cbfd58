// Layers by four: every `phases`-th layer from one on, `per_phase` fours of each. Those of a phase are whole px apart.
fn layer_of(quad: u32, j: u32) -> u32 {
    return quad / per_phase + phases * (4u * (quad % per_phase) + j);
}
