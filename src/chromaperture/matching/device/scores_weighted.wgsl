// `correlation.wgsl` leaves scores times their pixels' weights, and the weights themselves in the maps that are no layer's.

@group(0) @binding(kept_at) var<storage, read_write> score: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(kept_at + 1u) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, quad: u32, found: vec4f) {
    let weight = max(planes[(view_count + 1u) * width * height + pixel], least_weight);
    let layers = 4u * quad + vec4u(0u, 1u, 2u, 3u);
    score[pixel * pitch / 4u + quad] = weight * select(vec4f(1.0), found, layers < vec4u(layer_count));
    if (layer_count == 4u * quads && quad == 0u) { score[pixel * pitch / 4u + quads] = vec4f(weight); }
}
