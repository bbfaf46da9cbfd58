// The best layer so far, from one chunk of filtered scores after the other, with the scores before and after it. Where
// it is an end of the range the disparity is unknown, and nobody reads the score beyond.

@group(0) @binding(0) var<storage, read> maps: array<vec4f>;  // (h, w, pitch): scores times weights, weights
@group(0) @binding(1) var<storage, read_write> best: array<f32>;  // (5, h, w): layer, before, at, after, last score

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pixels) { return; }
    var layer = -2.0;
    var before = 0.0;
    var at = -1.0e30;
    var after = 0.0;
    var last = 0.0;
    if (first_layer > 0u) {
        layer = best[i];
        before = best[pixels + i];
        at = best[2u * pixels + i];
        after = best[3u * pixels + i];
        last = best[4u * pixels + i];
    }
    let start = i * pitch / 4u;
    let of_weight = select(4u * quads, 4u * quads - 1u, layer_count < 4u * quads);  // the last map, no layer's
    let weight = maps[start + of_weight / 4u][of_weight % 4u];
    for (var q = 0u; q < quads; q++) {
        let four = maps[start + q] / weight;
        for (var j = 0u; j < 4u; j++) {  // unrolled
            let c = 4u * q + j;
            let here = select(-2.0e30, four[j], c < layer_count);
            let number = f32(first_layer + c);
            let is_better = here > at;
            after = select(after, here, number == layer + 1.0);
            layer = select(layer, number, is_better);
            before = select(before, last, is_better);
            at = max(at, here);
            last = select(last, here, c < layer_count);
        }
    }
    best[i] = layer;
    best[pixels + i] = before;
    best[2u * pixels + i] = at;
    best[3u * pixels + i] = after;
    best[4u * pixels + i] = last;
}
