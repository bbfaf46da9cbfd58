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

@group(0) @binding(0) var<storage, read> spectra: array<f32>;  // (windows, 3, 2, frequencies)
@group(0) @binding(1) var<storage, read> powers: array<f32>;  // (slopes, nodes, layers, 9, frequencies)
@group(0) @binding(2) var<storage, read> nodes: array<u32>;  // (windows,)
@group(0) @binding(3) var<storage, read> noises: array<f32>;  // (windows, 3)
@group(0) @binding(4) var<storage, read_write> by_slope: array<f32>;  // (layers, slopes, windows)

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

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
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
