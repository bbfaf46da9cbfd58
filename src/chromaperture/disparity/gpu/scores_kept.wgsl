// `correlation.wgsl` leaves scores as they are.

@group(0) @binding(5) var<storage, read_write> score: array<f32>;  // (h, w, pitch)

fn keep(pixel: u32, layer: u32, found: vec4f) {
    for (var j = 0u; j < min(4u, layer_count - layer); j++) {
        score[pixel * pitch + first_layer + layer + j] = found[j];
    }
}
