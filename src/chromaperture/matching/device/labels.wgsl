// Likelihoods at labels.

// ---- label_polynomial
// Reads a pixel's or a sample's unexplained fractions of all layers at a label; see `layer_polynomial`.

// A straight continuation at both ends; every invocation calls it.
fn continue_ladder(local: u32) {
    workgroupBarrier();
    if (local == 0u) {
        ladder[1] = 2.0 * ladder[2] - ladder[3];
        ladder[0] = 2.0 * ladder[1] - ladder[2];
        ladder[layers + 2u] = 2.0 * ladder[layers + 1u] - ladder[layers];
        ladder[layers + 3u] = 2.0 * ladder[layers + 2u] - ladder[layers + 1u];
    }
    workgroupBarrier();
}

// At a place in layers from the first; 1, no evidence, beyond all layers.
fn unexplained_at(place: f32) -> f32 {
    let low = u32(clamp(floor(place), 0.0, f32(layers - 2u)));
    let found = through_six(low, place - f32(low));
    let value = max(found, least_unexplained * min(ladder[low + 2u], ladder[low + 3u]));
    return select(1.0, value, place > -edge_layers && place < f32(layers - 1u) + edge_layers);
}

// ---- labels_of_samples: layer_polynomial, label_polynomial
// Unexplained fractions at the labels of a map, of every sample; see `readable/paths.py`, read_at_labels. A workgroup has
// one sample. A map varies so little between samples that pixels need no polynomials of their own.

in unexplained: array<f32>;  // (samples, layers)
in label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
out at_labels: array<f32>;  // (samples, count)

fn main(group, groups, local) {
    let sample = group.x + group.y * groups.x;
    if (sample >= sample_width * sample_height) { return; }
    for (var k = local; k < layers; k += 64u) { ladder[k + 2u] = unexplained[sample * layers + k]; }
    continue_ladder(local);
    let x = min(sample % sample_width * spacing, width - 1u);
    let y = min(sample / sample_width * spacing, height - 1u);
    let map = label_map[select(y * width + x, 0u, one_map)];
    for (var n = local; n < count; n += 64u) {
        at_labels[sample * count + n] = unexplained_at(map.x + map.y * (first_label + label_step * f32(n)));
    }
}

// ---- windows_none
// Where windows of all channels are no evidence.
fn of_windows(middle: vec2f, block: u32, n: u32) -> f32 {
    return 0.0;
}

// ---- windows_enlarged
// Windows' evidence in a block, bilinear between windows; beyond the last one it holds.

@group(0) @binding(3) var<storage, read> windows: array<f32>;  // (window rows, window columns, count) nats
@group(0) @binding(4) var<storage, read> usable: array<f32>;  // (block rows, block columns)

fn of_windows(middle: vec2f, block: u32, n: u32) -> f32 {
    let last = vec2u(window_columns - 1u, window_rows - 1u);
    let place = min(middle / f32(stride), vec2f(last));
    let low = vec2u(place);
    let high = min(low + 1u, last);
    let above = low.y * window_columns;
    let below = high.y * window_columns;
    let upper = mix(windows[(above + low.x) * count + n], windows[(above + high.x) * count + n], fract(place.x));
    let lower = mix(windows[(below + low.x) * count + n], windows[(below + high.x) * count + n], fract(place.x));
    return usable[block] * mix(upper, lower, fract(place.y));
}

// ---- labels_between
// Log-likelihoods of every block: linear between the unexplained fractions of samples, and what windows of all channels
// say besides. A workgroup has one block.

in at_labels: array<f32>;  // (samples, count)
in counted: array<f32>;  // (block rows, block columns): how much of the pairs' evidence is its own
out likelihood: array<f32>;  // (block rows, block columns, count) nats a pixel

fn main(group, groups, local) {
    let block = group.x + group.y * groups.x;
    if (block >= block_columns * block_rows) { return; }
    let middle = vec2f(vec2u(block % block_columns, block / block_columns) * block_px) + f32(block_px - 1u) / 2.0;
    let last = vec2u(sample_width - 1u, sample_height - 1u);
    let place = min(middle / f32(spacing), vec2f(last));
    let low = vec2u(place);
    let high = min(low + 1u, last);
    let above = low.y * sample_width;
    let below = high.y * sample_width;
    for (var n = local; n < count; n += 64u) {
        let upper = mix(at_labels[(above + low.x) * count + n], at_labels[(above + high.x) * count + n], fract(place.x));
        let lower = mix(at_labels[(below + low.x) * count + n], at_labels[(below + high.x) * count + n], fract(place.x));
        let nats = max(-factors / 2.0 * log(mix(upper, lower, fract(place.y))), 0.0);
        likelihood[block * count + n] = counted[block] * nats + of_windows(middle, block, n);
    }
}

// ---- labels_read: layer_polynomial, label_polynomial
// Log-likelihoods at the labels of a map, of the scores of every pixel; see `readable/paths.py`, read_at_labels. A
// workgroup has one pixel.

in scores: array<f32>;  // (h, w, layers), of two or three views
in label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
out likelihood: array<f32>;  // (h, w, count) nats

fn unexplained_by(score: f32) -> f32 {
    let explained = clamp(score, 0.0, 1.0);
    return 1.0 - most_explained * select(explained, explained * explained, views_of_score == 2u);
}

fn main(group, groups, local) {
    let pixel = group.x + group.y * groups.x;
    if (pixel >= width * height) { return; }
    for (var k = local; k < layers; k += 64u) { ladder[k + 2u] = unexplained_by(scores[pixel * layers + k]); }
    continue_ladder(local);
    let map = label_map[select(pixel, 0u, one_map)];
    for (var n = local; n < count; n += 64u) {
        let value = unexplained_at(map.x + map.y * (first_label + label_step * f32(n)));
        let before = select(likelihood[pixel * count + n], 0.0, is_first);
        likelihood[pixel * count + n] = before + max(-factors / 2.0 * log(value), 0.0) * weight;
    }
}
