// `correlation.wgsl` leaves scores as they are.

@group(0) @binding(kept_at) var<storage, read_write> score: array<f32>;  // (h, w, pitch)

fn keep(pixel: u32, quad: u32, found: vec4f) {
    for (var j = 0u; j < 4u; j++) {
        let layer = 4u * quad + j;
        if (layer < layer_count) { score[pixel * pitch + first_layer + layer] = found[j]; }
    }
}
