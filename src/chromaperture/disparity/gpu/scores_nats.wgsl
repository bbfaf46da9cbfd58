// `correlation.wgsl` leaves log-likelihoods, nats. Chunks begin with a multiple of four layers.

@group(0) @binding(5) var<storage, read_write> likelihood: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(6) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, layer: u32, found: vec4f) {
    let mask = planes[(view_count + 1u) * width * height + pixel];
    likelihood[(pixel * pitch + first_layer + layer) / 4u] = mask * nats_of(1.0 - found);
}
