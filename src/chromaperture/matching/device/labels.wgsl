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
fn of_windows(x: u32, y: u32, n: u32) -> f32 {
    return 0.0;
}

// ---- windows_enlarged
// Windows' evidence at a pixel, bilinear between windows; beyond the last one it holds.

@group(0) @binding(3) var<storage, read> windows: array<f32>;  // (window rows, window columns, count) nats
@group(0) @binding(4) var<storage, read> usable: array<f32>;  // (h, w)

fn of_windows(x: u32, y: u32, n: u32) -> f32 {
    let left = min(x / stride, window_columns - 1u);
    let right = min(x / stride + 1u, window_columns - 1u);
    let above = min(y / stride, window_rows - 1u) * window_columns;
    let below = min(y / stride + 1u, window_rows - 1u) * window_columns;
    let share = vec2f(vec2u(x, y) % stride) / f32(stride);
    let upper = mix(windows[(above + left) * count + n], windows[(above + right) * count + n], share.x);
    let lower = mix(windows[(below + left) * count + n], windows[(below + right) * count + n], share.x);
    return usable[y * width + x] * mix(upper, lower, share.y);
}

// ---- labels_between
// Log-likelihoods of every pixel: linear between the unexplained fractions of samples, and what windows of all channels
// say besides. A workgroup has the pixels of a row between two samples.

in at_labels: array<f32>;  // (samples, count)
in counted: array<f32>;  // (h, w): how much of the pairs' evidence is its own
out likelihood: array<f32>;  // (h, w, count) nats

fn main(group, groups, local) {
    let cell = group.x + group.y * groups.x;
    if (cell >= sample_width * height) { return; }
    let y = cell / sample_width;
    let left = cell % sample_width;
    let right = min(left + 1u, sample_width - 1u);
    let above = min(y / spacing, sample_height - 1u) * sample_width;
    let below = min(y / spacing + 1u, sample_height - 1u) * sample_width;
    let down = f32(y % spacing) / f32(spacing);
    let first = left * spacing;
    for (var n = local; n < count; n += 64u) {
        let before = mix(at_labels[(above + left) * count + n], at_labels[(below + left) * count + n], down);
        let behind = mix(at_labels[(above + right) * count + n], at_labels[(below + right) * count + n], down);
        for (var x = first; x < min(first + spacing, width); x++) {
            let value = mix(before, behind, f32(x - first) / f32(spacing));
            let pixel = y * width + x;
            likelihood[pixel * count + n] = counted[pixel] * max(-factors / 2.0 * log(value), 0.0) + of_windows(x, y, n);
        }
    }
}

// ---- labels_read: layer_polynomial, label_polynomial
// Log-likelihoods at the labels of a map, of the scores of every pixel; see `readable/paths.py`, read_at_labels. A
// workgroup has one pixel.

in scores: array<f32>;  // (h, w, layers), of two or three views
in label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
in usable: array<f32>;  // (h, w)
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
        likelihood[pixel * count + n] = before + max(-factors / 2.0 * log(value), 0.0) * usable[pixel] * weight;
    }
}
