// `correlation.wgsl` leaves log-likelihoods, nats. Chunks begin with a multiple of four layers.

@group(0) @binding(kept_at) var<storage, read_write> likelihood: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(kept_at + 1u) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, quad: u32, found: vec4f) {
    let mask = planes[(view_count + 1u) * width * height + pixel];
    likelihood[(pixel * pitch + first_layer) / 4u + quad] = mask * nats_of(1.0 - found);
}
