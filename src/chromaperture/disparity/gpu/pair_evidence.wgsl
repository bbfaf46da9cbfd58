// What all pairs and bands of a sample earn at every layer, as the unexplained fraction exp(-2 l / factors), in which
// `labels_read.wgsl` interpolates. A workgroup has one sample. See `blur_evidence.py`.

@group(0) @binding(0) var<storage, read> correlation: array<f32>;  // see `correlations.wgsl`
// (count,): where a layer's correlation is; odd ones may lie between even ones: -1
@group(0) @binding(1) var<storage, read> places: array<i32>;
@group(0) @binding(2) var<storage, read_write> unexplained: array<f32>;  // (samples, count)

const evens = (count + 1u) / 2u;
const fourths = (evens + 1u) / 2u;

var<workgroup> known: array<f32, evens>;  // every second layer of a pair's band
var<workgroup> few: array<f32, fourths>;  // every fourth one of a secondary pair
var<workgroup> most: array<f32, 64>;

// Half way between the inner two of six numbers by a polynomial, sums of the outermost, the next and the inner two.
fn halfway(far: f32, near: f32, inner: f32) -> f32 {
    return (3.0 * far - 25.0 * near + 150.0 * inner) / 256.0;
}

// Every fourth layer, and its odd continuation.
fn fourth_layer(k: i32) -> f32 {
    let last = i32(fourths) - 1i;
    if (k < 0i) { return 2.0 * few[0] - few[min(-k, last)]; }
    if (k > last) { return 2.0 * few[last] - few[max(2i * last - k, 0i)]; }
    return few[k];
}

// Secondary pairs change half as fast with the layer: they count at every fourth, and at the last.
fn second_layer(first: u32, k: u32) -> f32 {
    if (k % 2u == 0u) { return few[k / 2u]; }
    if (k == evens - 1u) { return correlation[first + fourths]; }
    let j = i32(k / 2u);
    return halfway(
        fourth_layer(j - 2i) + fourth_layer(j + 3i), fourth_layer(j - 1i) + fourth_layer(j + 2i),
        fourth_layer(j) + fourth_layer(j + 1i)
    );
}

fn even_layer(k: i32) -> f32 {
    let last = i32(evens) - 1i;
    if (k < 0i) { return 2.0 * known[0] - known[min(-k, last)]; }
    if (k > last) { return 2.0 * known[last] - known[max(2i * last - k, 0i)]; }
    return known[k];
}

fn at_layer(first: u32, layer: u32, is_primary: bool) -> f32 {
    let k = i32(layer / 2u);
    if (layer % 2u == 0u) { return known[k]; }
    if (places[layer] >= 0i && is_primary) { return correlation[first + u32(places[layer])]; }
    return halfway(
        even_layer(k - 2i) + even_layer(k + 3i), even_layer(k - 1i) + even_layer(k + 2i),
        even_layer(k) + even_layer(k + 1i)
    );
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let sample = group.x + group.y * groups.x;
    if (sample >= samples) { return; }
    var likelihood: array<f32, (count + 63u) / 64u>;
    var further: array<f32, (count + 63u) / 64u>;  // of secondary pairs
    for (var pair = 0u; pair < pairs; pair++) {
        let is_primary = pair < primary_pairs;
        for (var band = 0u; band < bands; band++) {
            let first = correlations_of(pair, band, samples, sample);
            workgroupBarrier();
            if (is_primary) {
                for (var k = local; k < evens; k += 64u) { known[k] = correlation[first + u32(places[2u * k])]; }
            } else {
                for (var k = local; k < fourths; k += 64u) { few[k] = correlation[first + k]; }
                workgroupBarrier();
                for (var k = local; k < evens; k += 64u) { known[k] = second_layer(first, k); }
            }
            workgroupBarrier();
            for (var layer = local; layer < count; layer += 64u) {
                let rho = max(at_layer(first, layer, is_primary), 0.0);
                let nats = -0.5 * weights[band] * log(1.0 - min(rho * rho, most_correlation2));
                if (is_primary) {
                    likelihood[layer / 64u] += nats / f32(primary_pairs);
                } else {
                    further[layer / 64u] += nats / f32(pairs - primary_pairs);
                }
            }
        }
    }
    var best = 0.0;  // no log-likelihood is below 0
    for (var layer = local; layer < count; layer += 64u) { best = max(best, likelihood[layer / 64u]); }
    most[local] = best;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { most[local] = max(most[local], most[local + half]); }
        workgroupBarrier();
    }
    let weight = fallback_weight * exp(-most[0] / fallback_nats);
    for (var layer = local; layer < count; layer += 64u) {
        var found = likelihood[layer / 64u];
        if (pairs > primary_pairs) { found += weight * further[layer / 64u]; }
        unexplained[sample * count + layer] = exp(-2.0 / factors * found);
    }
}
