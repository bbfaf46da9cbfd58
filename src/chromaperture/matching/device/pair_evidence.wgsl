// What all pairs and bands of a sample earn at every layer, as the unexplained fraction exp(-2 l / factors), in which
// `labels_read.wgsl` interpolates. A workgroup has one sample. See `blur_evidence.py`.

@group(0) @binding(0) var<storage, read> correlation: array<f32>;  // see `correlations.wgsl`
// (count,): where a layer's correlation is; odd ones may lie between even ones: -1
@group(0) @binding(1) var<storage, read> places: array<i32>;
@group(0) @binding(2) var<storage, read_write> unexplained: array<f32>;  // (samples, count)

const evens = (count + 1u) / 2u;
const fourths = (evens + 1u) / 2u;
const primary_lists = primary_pairs * bands;
const lists = pairs * bands;
const first_few = lists * (evens + 4u);
const is_primary = vec3f(f32(primary_pairs > 0u), f32(primary_pairs > 1u), f32(primary_pairs > 2u));
const chunks = (count + 63u) / 64u;

// Every second layer of all pairs' bands, then every fourth of those of secondary pairs: lists between two numbers
// to either side that continue them.
var<workgroup> ladder: array<f32, first_few + (lists - primary_lists) * (fourths + 4u)>;
var<workgroup> most: array<f32, 64>;

fn seconds_of(list: u32) -> u32 {
    return list * (evens + 4u) + 2u;
}

fn fourths_of(list: u32) -> u32 {
    return first_few + (list - primary_lists) * (fourths + 4u) + 2u;
}

// An odd continuation, by the nearer number (0) or the further one (1) at either end.
fn continue_list(first: u32, length: u32, further: u32) {
    let away = min(further + 1u, length - 1u);
    let last = first + length - 1u;
    ladder[first - 1u - further] = 2.0 * ladder[first] - ladder[first + away];
    ladder[last + 1u + further] = 2.0 * ladder[last] - ladder[last - away];
}

// Half way to the next number of a list, by a polynomial through six.
fn halfway(at: u32) -> f32 {
    let inner = ladder[at] + ladder[at + 1u];
    let near = ladder[at - 1u] + ladder[at + 2u];
    return (3.0 * (ladder[at - 2u] + ladder[at + 3u]) - 25.0 * near + 150.0 * inner) / 256.0;
}

// Secondary pairs change half as fast with the layer: they count at every fourth, and at the last.
fn fill_lists(sample: u32, local: u32) {
    for (var i = local; i < primary_lists * evens; i += 64u) {
        let k = i % evens;
        let first = correlations_of(i / evens / bands, i / evens % bands, samples, sample);
        ladder[seconds_of(i / evens) + k] = correlation[first + u32(places[2u * k])];
    }
    for (var i = primary_lists * fourths + local; i < lists * fourths; i += 64u) {
        let first = correlations_of(i / fourths / bands, i / fourths % bands, samples, sample);
        ladder[fourths_of(i / fourths) + i % fourths] = correlation[first + i % fourths];
    }
    workgroupBarrier();
    for (var i = 2u * primary_lists + local; i < 2u * lists; i += 64u) {
        continue_list(fourths_of(i / 2u), fourths, i % 2u);
    }
    workgroupBarrier();
    for (var i = primary_lists * evens + local; i < lists * evens; i += 64u) {
        let list = i / evens;
        let k = i % evens;
        let at = fourths_of(list) + k / 2u;
        var value = ladder[at];
        if (k == evens - 1u && k % 2u == 1u) {
            value = correlation[correlations_of(list / bands, list % bands, samples, sample) + fourths];
        } else if (k % 2u == 1u) {
            value = halfway(at);
        }
        ladder[seconds_of(list) + k] = value;
    }
    workgroupBarrier();
    for (var i = local; i < 2u * lists; i += 64u) { continue_list(seconds_of(i / 2u), evens, i % 2u); }
    workgroupBarrier();
}

// The correlation of a pair in a band at a layer, or what lies between those of its neighbours.
fn correlation_at(pair: u32, band: u32, layer: u32, place: i32, sample: u32) -> f32 {
    let list = pair * bands + band;
    let at = seconds_of(list) + layer / 2u;
    if (layer % 2u == 0u) { return ladder[at]; }
    if (place >= 0i && pair < primary_pairs) {
        return correlation[correlations_of(pair, band, samples, sample) + u32(place)];
    }
    return halfway(at);
}

// `blur_evidence.explained_variance`: a negative correlation counts as far as the product of the other two is negative.
// That product is 0 where there are fewer than three pairs.
fn explained_variance(rho: vec3f) -> vec3f {
    let contrary = clamp(rho.yzx * rho.zxy / -contrary_product, vec3f(), vec3f(1.0));
    let counted = select(vec3f(1.0), contrary, rho < vec3f());
    return min(counted * rho * rho, vec3f(most_correlation2));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let sample = group.x + group.y * groups.x;
    if (sample >= samples) { return; }
    fill_lists(sample, local);
    var earned: array<vec2f, chunks>;  // of primary and of secondary pairs
    var best = 0.0;  // no log-likelihood is below 0
    for (var chunk = 0u; chunk < chunks; chunk++) {
        let layer = min(64u * chunk + local, count - 1u);
        let place = places[layer];
        var sums = vec2f();
        for (var band = 0u; band < bands; band++) {  // unrolled
            var rho = vec3f();  // of a pair each: there are three at most
            for (var pair = 0u; pair < pairs; pair++) {  // unrolled
                rho[pair] = correlation_at(pair, band, layer, place, sample);
            }
            let nats = -0.5 * weights[band] * log(1.0 - explained_variance(rho));
            sums += vec2f(dot(nats, is_primary), dot(nats, vec3f(1.0) - is_primary));
        }
        earned[chunk] = sums / max(vec2f(1.0), vec2f(f32(primary_pairs), f32(pairs - primary_pairs)));
        best = max(best, earned[chunk].x);
    }
    most[local] = best;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { most[local] = max(most[local], most[local + half]); }
        workgroupBarrier();
    }
    let weight = fallback_weight * exp(-most[0] / fallback_nats);
    for (var chunk = 0u; chunk < chunks; chunk++) {
        let layer = 64u * chunk + local;
        if (layer < count) {
            unexplained[sample * count + layer] = exp(-2.0 / factors * (earned[chunk].x + weight * earned[chunk].y));
        }
    }
}
