// Scores to log-likelihoods, nats, at labels on and between the layers, of equal depth: by polynomials
// through six layers.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (cells, all_layers)
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
@group(0) @binding(2) var<storage, read> planes: array<f32>;  // of the cells; the mask is the one behind K + 1 others
@group(0) @binding(3) var<storage, read_write> likelihood: array<vec4f>;  // (cells, pitch / 4)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height * pitch / 4u) { return; }
    let cell = i / (pitch / 4u);
    let start = cell * all_layers;
    let label = half_label(cell % width, cell / width);
    let begin = (label.x + (label.y - 1.0) * first_px) / layer_step_px;
    let mask = planes[(view_count + 1u) * width * height + cell];
    var values = vec4f();  // labels that only fill the last vector stay without a likelihood
    for (var j = 0u; j < 4u; j++) {
        let n = 4u * (i % (pitch / 4u)) + j;
        if (n >= label_count) { continue; }
        let place = begin + label.y * f32(n) / f32(parts);
        let below = clamp(i32(place), 0i, i32(all_layers) - 2i);
        let t = place - f32(below);
        let low = score[start + u32(below)];
        let high = score[start + u32(below) + 1u];
        let inner = low + t * (high - low);
        let middle = (2.0 - t) * score[start + inside(below - 1i, all_layers)]
            + (1.0 + t) * score[start + inside(below + 2i, all_layers)];
        let outer = (3.0 - t) * score[start + inside(below - 2i, all_layers)]
            + (2.0 + t) * score[start + inside(below + 3i, all_layers)];
        let a = t * (t - 1.0);
        let value = (a - 6.0) * ((a - 2.0) / 12.0 * inner - a / 24.0 * middle) + a * (a - 2.0) / 120.0 * outer;
        values[j] = select(value, 0.0, t < 0.0 || t > 1.0);
    }
    likelihood[i] = mask * nats_of(values);
}
