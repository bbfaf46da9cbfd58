// Evidence of all three channels in windows.

// ---- repeated
// Mirrored at the border, whose pixel is repeated ("symmetric" of NumPy's pad).
fn repeated(at: i32, count: u32) -> u32 {
    let end = i32(count);
    var place = at;
    while (place < 0i || place >= end) { place = select(2i * end - 1i - place, -1i - place, place < 0i); }
    return u32(place);
}

// ---- window_rows: indexing, repeated
// Products of windows of a picture with tapered waves along y, at every column; see `spectral_model.py`, Windows.

in image: array<f32>;  // (h, w, 3)
in shading: array<f32>;  // alike
in waves: array<vec4f>;  // (side, pairs): cosine and sine of two waves
out rows: array<vec4f>;  // (window rows, pairs, w, 3)

fn main(i) {
    if (i >= window_rows * pairs * width * 3u) { return; }
    let column = i % (3u * width);
    let pair = i / (3u * width) % pairs;
    let top = i32(i / (3u * width * pairs) * stride) - i32(side / 2u);
    var sum = vec4f();
    for (var s = 0u; s < side; s++) {
        let at = repeated(top + i32(s), height) * 3u * width + column;
        sum += (image[at] - shading[at]) * waves[s * pairs + pair];
    }
    rows[i] = sum;
}

// ---- window_spectra: repeated
// Spectra of tapered windows, less their mean under the taper; see `spectral_model.py`, Windows. A workgroup has one
// window.

in rows: array<vec2f>;  // (window rows, pairs, w, 3, 2): `window_rows`
in waves: array<vec2f>;  // (side, pairs, 2): cosine and sine
in numbers: array<vec2i>;  // (frequencies,): waves a period along x and y
in taper: array<vec2f>;  // (frequencies,): of an even picture
out spectra: array<f32>;  // (windows, 3, 2, frequencies)

var<workgroup> mean: vec3f;

fn main(group, groups, local) {
    let window = group.x + group.y * groups.x;
    if (window >= window_rows * window_columns) { return; }
    let left = i32(window % window_columns * stride) - i32(side / 2u);
    let first = window / window_columns * pairs;
    if (local < 3u) {
        var sum = 0.0;
        for (var s = 0u; s < side; s++) {
            sum += rows[((first * width + repeated(left + i32(s), width)) * 3u + local) * 2u].x * waves[s * pairs * 2u].x;
        }
        mean[local] = sum;
    }
    workgroupBarrier();
    let means = mean;
    for (var f = local; f < frequencies; f += 64u) {
        let number = numbers[f];
        let down = u32(abs(number.y));
        let line = (first + down / 2u) * width;
        let mirror = select(1.0, -1.0, number.y < 0i);
        var real = vec3f();
        var imaginary = vec3f();
        for (var s = 0u; s < side; s++) {
            let at = (line + repeated(left + i32(s), width)) * 6u + down % 2u;
            let along = waves[s * pairs * 2u + u32(number.x)];
            let red = rows[at];
            let green = rows[at + 2u];
            let blue = rows[at + 4u];
            let even = vec3f(red.x, green.x, blue.x);
            let odd = mirror * vec3f(red.y, green.y, blue.y);
            real += even * along.x - odd * along.y;
            imaginary -= odd * along.x + even * along.y;
        }
        real -= means * taper[f].x;
        imaginary -= means * taper[f].y;
        for (var k = 0u; k < 3u; k++) {
            let to = (window * 6u + 2u * k) * frequencies + f;
            spectra[to] = real[k];
            spectra[to + frequencies] = imaginary[k];
        }
    }
}

// ---- spectral_likelihood
// Sums over the invocations that share a window, through shared memory; all of them get the same sum.
const lanes = 8u;

var<workgroup> lane_sums: array<vec3f, 64>;
var<private> lane_here: u32;

fn sum_of_lanes(own: vec3f) -> vec3f {
    workgroupBarrier();
    lane_sums[lane_here] = own;
    workgroupBarrier();
    let first = lane_here - lane_here % lanes;
    var sum = lane_sums[first];
    for (var k = 1u; k < lanes; k++) { sum += lane_sums[first + k]; }
    return sum;
}

// Log-likelihood of windows' spectra at every layer, for every slope; see `readable/spectral_likelihood.py`. The
// invocations of a window share its frequencies. Colours correlate to 0.998. So a covariance is factored as L D L*, in
// single precision exact to 1e-4, where its determinant written out would be off by 1 %; and of the colours' covariance
// S = R R^T the root R is kept: S <- R (1 + R^T M R / F) R^T loses nothing of what is small in S.

in spectra: array<f32>;  // (windows, 3, 2, frequencies)
in powers: array<f32>;  // (slopes, nodes, layers, 9, frequencies)
in nodes: array<u32>;  // (windows,)
in noises: array<f32>;  // (windows, 3)
out by_slope: array<f32>;  // (layers, slopes, windows)

const smallest = 1.0e-12f;  // of a pivot, before its root

// A frequency's covariance as L D L*: D, and L_10, L_20, L_21.
struct Factors { pivots: vec3f, l10: vec2f, l20: vec2f, l21: vec2f }

// Its powers: the diagonal, 01, 02, 12.
struct Passed { own: vec3f, g01: vec2f, g02: vec2f, g12: vec2f }

fn times(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

fn conjugate(a: vec2f) -> vec2f {
    return vec2f(a.x, -a.y);
}

fn passed_at(at: u32) -> Passed {
    return Passed(
        vec3f(powers[at], powers[at + frequencies], powers[at + 2u * frequencies]),
        vec2f(powers[at + 3u * frequencies], powers[at + 4u * frequencies]),
        vec2f(powers[at + 5u * frequencies], powers[at + 6u * frequencies]),
        vec2f(powers[at + 7u * frequencies], powers[at + 8u * frequencies])
    );
}

// Colours: variances, and covariances 01, 02, 12.
fn factored(g: Passed, variances: vec3f, covariances: vec3f, noise: vec3f) -> Factors {
    let diagonal = variances * g.own * (1.0 + channel_error) + noise;
    let l10 = covariances.x * conjugate(g.g01) / diagonal.x;
    let l20 = covariances.y * conjugate(g.g02) / diagonal.x;
    let second = diagonal.y - dot(l10, l10) * diagonal.x;
    let left = covariances.z * conjugate(g.g12) - times(l20, conjugate(l10)) * diagonal.x;
    let l21 = left / second;
    let third = diagonal.z - dot(l20, l20) * diagonal.x - dot(l21, l21) * second;
    return Factors(vec3f(diagonal.x, second, third), l10, l20, l21);
}

// R: its diagonal, and 10, 20, 21.
struct Root { own: vec3f, below: vec3f, is_valid: bool }

// Root after a part of the step R^T M R / F, of its diagonal and 01, 02, 12.
fn moved(r: Root, own: vec3f, cross: vec3f, part: f32) -> Root {
    let first = 1.0 + part * own.x;
    let k0 = sqrt(max(first, smallest));
    let k10 = part * cross.x / k0;
    let k20 = part * cross.y / k0;
    let second = 1.0 + part * own.y - k10 * k10;
    let k1 = sqrt(max(second, smallest));
    let k21 = (part * cross.z - k20 * k10) / k1;
    let third = 1.0 + part * own.z - k20 * k20 - k21 * k21;
    let k2 = sqrt(max(third, smallest));
    let next = r.own * vec3f(k0, k1, k2);
    let below = vec3f(
        r.below.x * k0 + r.own.y * k10, r.below.y * k0 + r.below.z * k10 + r.own.z * k20, r.below.z * k1 + r.own.z * k21
    );
    let variances = variances_of(next, below);
    let correlations = next * next / variances;  // their product is the determinant
    let is_valid = min(first, min(second, third)) > smallest && correlations.y * correlations.z > least_determinant
        && min(variances.x, min(variances.y, variances.z)) > least_amplitude;
    return Root(next, below, is_valid);
}

fn variances_of(own: vec3f, below: vec3f) -> vec3f {
    return own * own + vec3f(0.0, below.x * below.x, below.y * below.y + below.z * below.z);
}

fn main(group, groups, local) {
    lane_here = local;
    let number = (group.x + group.y * groups.x) * (64u / lanes) + local / lanes;
    let used = number < windows * slopes;
    let window = min(number, windows * slopes - 1u) % windows;
    let slope = min(number, windows * slopes - 1u) / windows;
    let lane = local % lanes;
    let noise = vec3f(noises[3u * window], noises[3u * window + 1u], noises[3u * window + 2u]);
    let seen = window * 6u * frequencies;
    let first = (slope * node_count + nodes[window]) * layers * 9u * frequencies;
    var surplus = vec3f();
    var passed = vec3f();
    for (var f = lane; f < frequencies; f += lanes) {
        for (var k = 0u; k < 3u; k++) {
            let y = vec2f(spectra[seen + 2u * k * frequencies + f], spectra[seen + (2u * k + 1u) * frequencies + f]);
            surplus[k] += dot(y, y) - noise[k];
            passed[k] += powers[first + k * frequencies + f];
        }
    }
    let amplitude = sqrt(max(sum_of_lanes(surplus) / sum_of_lanes(passed), vec3f(least_amplitude)));
    // The root of correlations that are all alike.
    let rho = first_correlation;
    let second = sqrt(1.0 - rho * rho);
    let l21 = (rho - rho * rho) / second;
    var root = Root(
        amplitude * vec3f(1.0, second, sqrt(1.0 - rho * rho - l21 * l21)), amplitude.yzz * vec3f(rho, rho, l21), true
    );
    for (var layer = 0u; layer < layers; layer++) {
        let of_layer = first + layer * 9u * frequencies;
        let last = rounds + select(0u, first_rounds, layer == 0u);
        for (var round = 0u; round <= last; round++) {
            let r = root.below;
            let variances = variances_of(root.own, r);
            let covariances = vec3f(root.own.x * r.x, root.own.x * r.y, r.x * r.y + root.own.y * r.z);
            var total = 0.0;
            var own = vec3f();
            var cross = vec3f();
            for (var f = lane; f < frequencies; f += lanes) {
                let g = passed_at(of_layer + f);
                let c = factored(g, variances, covariances, noise);
                let y0 = vec2f(spectra[seen + f], spectra[seen + frequencies + f]);
                let y1 = vec2f(spectra[seen + 2u * frequencies + f], spectra[seen + 3u * frequencies + f]);
                let y2 = vec2f(spectra[seen + 4u * frequencies + f], spectra[seen + 5u * frequencies + f]);
                let x1 = y1 - times(c.l10, y0);
                let x2 = y2 - times(c.l20, y0) - times(c.l21, x1);
                let inverse = 1.0 / c.pivots;
                if (round == last) {
                    total -= dot(vec3f(dot(y0, y0), dot(x1, x1), dot(x2, x2)), inverse);
                    total -= log(c.pivots.x * c.pivots.y) + log(c.pivots.z);
                    continue;
                }
                let t2 = x2 * inverse.z;
                let t1 = x1 * inverse.y - times(conjugate(c.l21), t2);
                let t0 = y0 * inverse.x - times(conjugate(c.l10), t1) - times(conjugate(c.l20), t2);
                // Of the inverse: L^-1 has -l10, -l21 and m20.
                let m20 = times(c.l21, c.l10) - c.l20;
                let i00 = inverse.x + dot(c.l10, c.l10) * inverse.y + dot(m20, m20) * inverse.z;
                let i11 = inverse.y + dot(c.l21, c.l21) * inverse.z;
                let i01 = -conjugate(c.l10) * inverse.y - times(conjugate(m20), c.l21) * inverse.z;
                own += (vec3f(dot(t0, t0), dot(t1, t1), dot(t2, t2)) - vec3f(i00, i11, inverse.z)) * g.own;
                cross += vec3f(
                    dot(times(t0, conjugate(t1)) - i01, g.g01),
                    dot(times(t0, conjugate(t2)) - conjugate(m20) * inverse.z, g.g02),
                    dot(times(t1, conjugate(t2)) + conjugate(c.l21) * inverse.z, g.g12)
                );
            }
            if (round == last) {
                let sum = sum_of_lanes(vec3f(total, 0.0, 0.0)).x;
                if (used && lane == 0u) { by_slope[(layer * slopes + slope) * windows + window] = sum; }
                continue;
            }
            own = sum_of_lanes(own) / f32(frequencies);
            cross = sum_of_lanes(cross) / f32(frequencies);
            let gradient = mat3x3f(own.x, cross.x, cross.y, cross.x, own.y, cross.z, cross.y, cross.z, own.z);
            let column0 = vec3f(root.own.x, r.x, r.y);
            let column1 = vec3f(0.0, root.own.y, r.z);
            let column2 = vec3f(0.0, 0.0, root.own.z);
            let along1 = gradient * column1;
            let along2 = gradient * column2;
            let step = vec3f(dot(column0, gradient * column0), dot(column1, along1), dot(column2, along2));
            let aside = vec3f(dot(column0, along1), dot(column0, along2), dot(column1, along2));
            // A full step, or a third of it, which cannot leave the covariances.
            let full = moved(root, step, aside, 1.0);
            if (full.is_valid) { root = full; } else { root = moved(root, step, aside, 1.0 / 3.0); }
        }
    }
}

// ---- slope_evidence: indexing
// What a window says of every slope, whatever the layer: the logarithm of the sum of the likelihoods, over the best of
// all; see `spectral.py`, over_slopes.

in by_slope: array<f32>;  // (layers, slopes, windows)
out of_slope: array<f32>;  // (slopes, windows)

fn main(group, groups, local) {
    let window = invocation(group, groups, local);
    if (window >= windows) { return; }
    var best = -1.0e30f;
    for (var slope = 0u; slope < slopes; slope++) {
        var highest = -1.0e30f;
        for (var layer = 0u; layer < layers; layer++) {
            highest = max(highest, by_slope[(layer * slopes + slope) * windows + window]);
        }
        var sum = 0.0;
        for (var layer = 0u; layer < layers; layer++) {
            sum += exp((by_slope[(layer * slopes + slope) * windows + window] - highest) / redundancy);
        }
        of_slope[slope * windows + window] = highest / redundancy + log(sum);
        best = max(best, highest / redundancy);
    }
    for (var slope = 0u; slope < slopes; slope++) { of_slope[slope * windows + window] -= best; }
}

// ---- slope_shares
// How often every slope is found in the picture, by expectation and maximisation; see `spectral.py`,
// over_slopes. One workgroup has all windows.

in of_slope: array<f32>;  // (slopes, windows)
out logs: array<f32>;  // (slopes,): logarithms of the shares

var<workgroup> sums: array<f32, 256>;

@workgroup_size(256)
fn main(local) {
    var log_share: array<f32, slopes>;
    for (var slope = 0u; slope < slopes; slope++) { log_share[slope] = log(1.0 / f32(slopes) + least_share); }
    for (var round = 0u; round < rounds; round++) {
        var own = array<f32, slopes>();
        for (var window = local; window < windows; window += 256u) {
            var best = -1.0e30f;
            for (var slope = 0u; slope < slopes; slope++) {
                best = max(best, log_share[slope] + of_slope[slope * windows + window]);
            }
            var sum = 0.0;
            for (var slope = 0u; slope < slopes; slope++) {
                sum += exp(log_share[slope] + of_slope[slope * windows + window] - best);
            }
            for (var slope = 0u; slope < slopes; slope++) {
                own[slope] += exp(log_share[slope] + of_slope[slope * windows + window] - best) / sum;
            }
        }
        for (var slope = 0u; slope < slopes; slope++) {
            workgroupBarrier();
            sums[local] = own[slope];
            workgroupBarrier();
            for (var half = 128u; half > 0u; half /= 2u) {
                if (local < half) { sums[local] += sums[local + half]; }
                workgroupBarrier();
            }
            log_share[slope] = log(sums[0] / f32(windows) + least_share);
        }
    }
    if (local == 0u) {
        for (var slope = 0u; slope < slopes; slope++) { logs[slope] = log_share[slope]; }
    }
}

// ---- window_labels: layer_polynomial
// What labels earn in every window: its log-likelihoods averaged over slopes, interpolated at the labels and limited;
// see `spectral.py`, over_slopes, _at_labels and _tempered. A workgroup has one window.

in by_slope: array<f32>;  // (layers, slopes, windows)
in log_share: array<f32>;  // (slopes,)
in label_map: array<vec2f>;  // (windows,) or (1,): offset and scale, in layers
out earned: array<f32>;  // (windows, count) nats a pixel

var<workgroup> extremes: array<vec2f, 64>;

fn main(group, groups, local) {
    let window = group.x + group.y * groups.x;
    if (window >= windows) { return; }
    // All are counted from the first layer's first slope: nothing of single precision goes into what they share.
    let origin = by_slope[window];
    for (var layer = local; layer < layers; layer += 64u) {
        var best = -1.0e30f;
        for (var slope = 0u; slope < slopes; slope++) {
            let at = (layer * slopes + slope) * windows + window;
            best = max(best, (by_slope[at] - origin) / redundancy + log_share[slope]);
        }
        var sum = 0.0;
        for (var slope = 0u; slope < slopes; slope++) {
            let at = (layer * slopes + slope) * windows + window;
            sum += exp((by_slope[at] - origin) / redundancy + log_share[slope] - best);
        }
        ladder[layer + 2u] = (best + log(sum)) / area_px2;
    }
    workgroupBarrier();
    if (local < 2u) {  // odd continuations at both ends
        ladder[1u - local] = 2.0 * ladder[2] - ladder[3u + local];
        ladder[layers + 2u + local] = 2.0 * ladder[layers + 1u] - ladder[layers - local];
    }
    workgroupBarrier();
    let map = label_map[select(window, 0u, one_map)];
    var value: array<f32, (count + 63u) / 64u>;
    var most = -1.0e30f;
    var least = 1.0e30f;
    for (var n = local; n < count; n += 64u) {
        let place = clamp(map.x + map.y * (first_label + label_step * f32(n)), 0.0, f32(layers - 1u));
        let low = min(u32(place), layers - 2u);
        value[n / 64u] = through_six(low, place - f32(low));
        most = max(most, value[n / 64u]);
        least = min(least, value[n / 64u]);
    }
    extremes[local] = vec2f(most, -least);
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { extremes[local] = max(extremes[local], extremes[local + half]); }
        workgroupBarrier();
    }
    let range = extremes[0];
    let nothing = cap_nats * exp(-gain / cap_nats * (range.x + range.y));
    for (var n = local; n < count; n += 64u) {
        earned[window * count + n] = cap_nats * exp(gain / cap_nats * (value[n / 64u] - range.x)) - nothing;
    }
}
