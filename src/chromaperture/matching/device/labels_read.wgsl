// Log-likelihoods at the labels of a map, of the scores of every pixel; see `readable/paths.py`, read_at_labels. A
// workgroup has one pixel.

@group(0) @binding(0) var<storage, read> scores: array<f32>;  // (h, w, layers), of two or three views
@group(0) @binding(1) var<storage, read> label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
@group(0) @binding(2) var<storage, read> usable: array<f32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> likelihood: array<f32>;  // (h, w, count) nats

fn unexplained_by(score: f32) -> f32 {
    let explained = clamp(score, 0.0, 1.0);
    return 1.0 - most_explained * select(explained, explained * explained, views_of_score == 2u);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
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
