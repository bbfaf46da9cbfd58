// `correlation.wgsl` leaves scores times their pixels' weights, and the weights themselves as one more map.

@group(0) @binding(5) var<storage, read_write> score: array<f32>;  // (h, w, pitch)
@group(0) @binding(6) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, layer: u32, found: vec4f) {
    let weight = max(planes[(view_count + 1u) * width * height + pixel], least_weight);
    for (var j = 0u; j < min(4u, layer_count - layer); j++) { score[pixel * pitch + layer + j] = weight * found[j]; }
    if (layer == 0u) { score[pixel * pitch + layer_count] = weight; }
}
