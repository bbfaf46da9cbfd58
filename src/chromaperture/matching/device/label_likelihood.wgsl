// Scores to log-likelihoods, nats, at labels on and between the layers, of equal depth: by polynomials
// through six layers.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (cells, all_layers), parts of 1 / score_parts
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
@group(0) @binding(2) var<storage, read> planes: array<f32>;  // of the cells; the mask is the one behind K + 1 others
@group(0) @binding(3) var<storage, read_write> likelihood: array<vec4f>;  // (cells, pitch / 4)

// What a score leaves of 1: of whole numbers, so that next to a score of 1 nothing is rounded off.
fn unexplained(at: u32) -> f32 {
    return (f32(score_parts) - score[at]) * (1.0 / f32(score_parts));
}

// The same up to two layers beyond either end, on the parabola through the three outermost layers.
fn continued(start: u32, layer: i32) -> f32 {
    let last = i32(all_layers) - 1i;
    if (layer >= 0i && layer <= last) { return unexplained(start + u32(layer)); }
    let end = select(start + u32(last), start, layer < 0i);
    let inwards = select(-1i, 1i, layer < 0i);
    let first = unexplained(end);
    let second = unexplained(u32(i32(end) + inwards));
    let beyond = 3.0 * (first - second) + unexplained(u32(i32(end) + 2i * inwards));
    return select(3.0 * (beyond - first) + second, beyond, layer == -1i || layer == last + 1i);
}

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
    let begin = (fma(label.y, first_px, label.x) - first_px) / layer_step_px;
    let mask = planes[(view_count + 1u) * width * height + cell];
    var values = vec4f(1.0);  // labels that only fill the last vector stay without a likelihood
    for (var j = 0u; j < 4u; j++) {
        let n = 4u * (i % (pitch / 4u)) + j;
        if (n >= label_count) { continue; }
        // In the CPU's order, eight layers at a time: what is rounded off decides between two log-likelihoods.
        let layer = n / parts;
        let start_of_eight = fma(label.y, f32(layer / 8u * 8u), begin + f32(n % parts) * (label.y / f32(parts)));
        let place = start_of_eight + label.y * f32(layer % 8u);
        let below = clamp(i32(floor(place)), 0i, i32(all_layers) - 2i);
        let t = fma(f32(layer % 8u), label.y - 1.0, start_of_eight - (f32(below) - f32(layer % 8u)));
        let low = unexplained(start + u32(below));
        let high = unexplained(start + u32(below) + 1u);
        let inner = fma(t, high - low, low);
        let middle = fma(2.0 - t, continued(start, below - 1i),
            (1.0 + t) * continued(start, below + 2i));
        let outer = fma(3.0 - t, continued(start, below - 2i),
            (2.0 + t) * continued(start, below + 3i));
        let a = t * (t - 1.0);
        let b = a - 2.0;
        let inside_four = fma(-(a * (1.0 / 24.0)), middle, b * (1.0 / 12.0) * inner);
        let value = fma(a - 6.0, inside_four, a * (b * (1.0 / 120.0)) * outer);
        values[j] = select(value, 1.0, place < 0.0 || place > f32(all_layers - 1u));
    }
    likelihood[i] = mask * nats_of(values);
}
