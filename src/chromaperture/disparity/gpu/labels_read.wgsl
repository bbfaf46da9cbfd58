// Log-likelihoods at the pixels and labels of a map: linear between samples, by a polynomial through six layers; see
// `stages/paths.py`, read_at_labels. A workgroup has one pixel.

// (samples, layers): unexplained fractions, or the scores of two or three views
@group(0) @binding(0) var<storage, read> unexplained: array<f32>;
@group(0) @binding(1) var<storage, read> label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
@group(0) @binding(2) var<storage, read> usable: array<f32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> likelihood: array<f32>;  // (h, w, count) nats

var<workgroup> ladder: array<f32, layers + 4u>;

fn fraction(at: u32) -> f32 {
    let value = unexplained[at];
    if (views_of_score == 2u) { return 1.0 - min(max(value, 0.0) * max(value, 0.0), most_correlation2); }
    if (views_of_score == 3u) { return max(1.0 - max(value, 0.0), sqrt(1.0 - most_correlation2)); }
    return value;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = group.x + group.y * groups.x;
    if (pixel >= width * height) { return; }
    let x = pixel % width;
    let y = pixel / width;
    let left = min(x / spacing, sample_width - 1u);
    let above = min(y / spacing, sample_height - 1u);
    let right = min(left + 1u, sample_width - 1u);
    let below = min(above + 1u, sample_height - 1u);
    let part = vec2f(vec2u(x, y) - spacing * vec2u(left, above)) / f32(spacing);
    for (var k = local; k < layers; k += 64u) {
        let upper_left = fraction((above * sample_width + left) * layers + k);
        let upper_right = fraction((above * sample_width + right) * layers + k);
        let lower_left = fraction((below * sample_width + left) * layers + k);
        let lower_right = fraction((below * sample_width + right) * layers + k);
        ladder[k + 2u] = (1.0 - part.x) * ((1.0 - part.y) * upper_left + part.y * lower_left)
            + part.x * ((1.0 - part.y) * upper_right + part.y * lower_right);
    }
    workgroupBarrier();
    if (local == 0u) {  // a straight continuation at both ends
        ladder[1] = 2.0 * ladder[2] - ladder[3];
        ladder[0] = 2.0 * ladder[1] - ladder[2];
        ladder[layers + 2u] = 2.0 * ladder[layers + 1u] - ladder[layers];
        ladder[layers + 3u] = 2.0 * ladder[layers + 2u] - ladder[layers + 1u];
    }
    workgroupBarrier();
    let map = label_map[select(pixel, 0u, one_map)];
    for (var n = local; n < count; n += 64u) {
        let place = map.x + map.y * (first_label + label_step * f32(n));
        let low = u32(clamp(floor(place), 0.0, f32(layers - 2u)));
        let t = place - f32(low);
        let a = t + 2.0;
        let b = t + 1.0;
        let c = t - 1.0;
        let d = t - 2.0;
        let e = t - 3.0;
        let between = a * e * (t * b * d * ladder[low + 3u] - b * c * d * ladder[low + 2u]) / 12.0;
        let beside = t * c * a * e * (d * ladder[low + 1u] - b * ladder[low + 4u]) / 24.0;
        let outer = b * t * c * d * (a * ladder[low + 5u] - e * ladder[low]) / 120.0;
        let least = least_unexplained * min(ladder[low + 2u], ladder[low + 3u]);
        let value = max(between + beside + outer, least);
        let inside = place > -edge_layers && place < f32(layers - 1u) + edge_layers;
        let found = select(0.0, max(-factors / 2.0 * log(value), 0.0), inside);
        let before = select(likelihood[pixel * count + n], 0.0, is_first);
        likelihood[pixel * count + n] = before + found * usable[pixel] * weight;
    }
}
