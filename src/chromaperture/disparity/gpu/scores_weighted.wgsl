// `correlation.wgsl` leaves scores times their pixels' weights, and the weights themselves as one more map.

@group(0) @binding(5) var<storage, read_write> score: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(6) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, layer: u32, found: vec4f) {
    let weight = max(planes[(view_count + 1u) * width * height + pixel], least_weight);
    let is_layer = vec4u(layer) + vec4u(0u, 1u, 2u, 3u) < vec4u(layer_count);
    score[(pixel * pitch + layer) / 4u] = weight * select(vec4f(1.0), found, is_layer);
    if (layer_count % 4u == 0u && layer == 0u) { score[(pixel * pitch + layer_count) / 4u] = vec4f(weight); }
}
