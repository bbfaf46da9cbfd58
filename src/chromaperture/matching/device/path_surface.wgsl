// From a volume of likelihoods to a surface.

// ---- volume_paths
// Costs of all paths of one direction (dx, dy) through a volume of log-likelihoods, added to `total`; see
// `readable/paths.py`. A path is walked by `lanes` invocations, each of which holds `own_layers` neighbouring layers.
// The least of L(q, e) + slope |d - e| over e is a scan up and one down the layers of an invocation; what comes from
// other invocations travels through shared memory together with the least cost, with one barrier a pixel. A step computes
// little and would wait for the memory: what it needs is read `ahead` steps before.

in likelihood: array<f32>;  // (h, w, count) nats
in guide: array<f32>;  // (h, w), in units of guide_range
out total: array<f32>;  // (h, w, count)

const paths = 64u / lanes;  // of a workgroup
const NEVER = 1.0e30f;  // cost of layers beyond the last

// Of the last layer, of the first, and the least: for this pixel and, at the other half, for the next one.
var<workgroup> ends: array<vec3f, 128>;

fn line_length(line: u32) -> u32 {
    let start = line_start(line);
    return min(select(width - start.x, 0xffffffu, dx == 0.0), select(height - start.y, 0xffffffu, dy == 0.0));
}

// First pixel as if both steps were positive: diagonals are counted from the lower left corner on.
fn line_start(line: u32) -> vec2u {
    if (dy == 0.0) { return vec2u(0u, line); }
    if (dx == 0.0) { return vec2u(line, 0u); }
    let along = i32(line) - i32(height - 1u);
    return vec2u(u32(max(along, 0i)), u32(max(-along, 0i)));
}

fn pixel_of(s: u32, start: vec2u, length: u32) -> u32 {
    let along = min(s, length - 1u);
    let flat = vec2u(select(along, 0u, dx == 0.0), select(along, 0u, dy == 0.0)) + start;
    let x = select(flat.x, width - 1u - flat.x, dx < 0.0);
    let y = select(flat.y, height - 1u - flat.y, dy < 0.0);
    return y * width + x;
}

fn main(group, local) {
    let first = group.x * paths;
    var steps = 0u;
    for (var i = first; i < min(first + paths, lines); i++) { steps = max(steps, line_length(i)); }
    let line = min(first + local / lanes, lines - 1u);
    let used = first + local / lanes < lines;
    let length = line_length(line);
    let start = line_start(line);
    let lane = local % lanes;
    let begin = lane * own_layers;
    let last_entry = width * height * count - 1u;
    var gains: array<f32, ahead * own_layers>;
    var totals: array<f32, ahead * own_layers>;
    var values: array<f32, ahead>;
    for (var j = 0u; j < ahead; j++) {  // unrolled
        let pixel = pixel_of(j, start, length);
        values[j] = guide[pixel];
        for (var r = 0u; r < own_layers; r++) {  // unrolled
            let entry = min(pixel * count + begin + r, last_entry);
            gains[j * own_layers + r] = likelihood[entry];
            if (!starts_total) { totals[j * own_layers + r] = total[entry]; }
        }
    }
    var cost: array<f32, own_layers>;
    for (var r = 0u; r < own_layers; r++) { cost[r] = select(0.0, NEVER, begin + r >= count); }
    var least = 0.0;
    var before = 0.0;
    for (var s0 = 0u; s0 < steps; s0 += ahead) {
        for (var j = 0u; j < ahead; j++) {  // unrolled
            let s = s0 + j;
            if (s >= steps) { break; }
            let pixel = pixel_of(s, start, length);
            let next = pixel_of(s + ahead, start, length);
            let link = select(
                edge_floor + (1.0 - edge_floor) * exp(-abs(values[j] - before) / edge_range), 1.0, s == 0u
            );
            before = values[j];
            values[j] = guide[next];
            let bend = slope * link;
            for (var r = 0u; r < own_layers; r++) {  // unrolled
                cost[r] = min(cost[r], cost[max(r, 1u) - 1u] + bend);
            }
            for (var r = 0u; r < own_layers; r++) {  // unrolled
                cost[own_layers - 1u - r] = min(cost[own_layers - 1u - r], cost[own_layers - max(r, 1u)] + bend);
            }
            let half = (s & 1u) * 64u;
            ends[half + local] = vec3f(cost[own_layers - 1u], cost[0], least);
            workgroupBarrier();
            var lowest = least;
            for (var k = 0u; k < lanes; k++) { lowest = min(lowest, ends[half + local - lane + k].z); }
            var below = NEVER;  // of the layer before the first
            var above = NEVER;  // of the layer behind the last
            for (var k = 1u; k <= reach; k++) {
                let further = bend * f32((k - 1u) * own_layers);
                if (lane >= k) { below = min(below, ends[half + local - k].x + further); }
                if (lane + k < lanes) { above = min(above, ends[half + local + k].y + further); }
            }
            let limit = lowest + jump * link;
            let at = pixel * count + begin;
            let at_next = next * count + begin;
            let counts = used && s < length;
            least = NEVER;
            for (var r = 0u; r < own_layers; r++) {  // unrolled
                let is_layer = begin + r < count;
                let gain = gains[j * own_layers + r];
                let before_total = totals[j * own_layers + r];
                gains[j * own_layers + r] = likelihood[min(at_next + r, last_entry)];
                if (!starts_total) { totals[j * own_layers + r] = total[min(at_next + r, last_entry)]; }
                let from_below = below + bend * f32(r + 1u);
                let from_above = above + bend * f32(own_layers - r);
                let last = min(min(cost[r], limit), min(from_below, from_above)) - lowest - gain;
                cost[r] = select(NEVER, last, is_layer);  // beyond the last layer the scans have reached it
                least = min(least, cost[r]);
                if (counts && is_layer) {
                    total[at + r] = last + select(before_total, own * gain, starts_total);
                }
            }
        }
    }
}

// ---- volume_winner: indexing
// The layer of least cost of every pixel, and how the log-likelihood runs about it: for `layer_offsets`.

in cost: array<f32>;  // (h, w, count)
in likelihood: array<f32>;  // (h, w, count)
// (h, w): nearest inner layer, slope and bend of the unexplained fraction about it
out winner: array<vec3f>;

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let at = pixel * count;
    var best = 0u;
    var least = cost[at];
    for (var k = 1u; k < count; k++) {
        let here = cost[at + k];
        if (here < least) {
            least = here;
            best = k;
        }
    }
    // A parabola through the costs may round to a neighbour only at half a layer exactly; then both are as near.
    let middle = clamp(best, 1u, count - 2u);
    let own = likelihood[at + middle];
    let left = exp(2.0 * (own - likelihood[at + middle - 1u]));
    let right = exp(2.0 * (own - likelihood[at + middle + 1u]));
    winner[pixel] = vec3f(f32(middle), (right - left) / 2.0, max((left + right) / 2.0 - 1.0, 0.0));
}

// ---- gaussian_line: indexing
// A filter of 2 reach + 1 taps along one axis of planes (planes, h, w, parts), mirrored at the borders. An invocation
// has eight neighbours on the axis, whose pixels overlap.

in before: array<f32>;
in taps: array<f32>;  // and 7 zeros
out after: array<f32>;

const across = select(height, width, along_x);
const eights = (across + 7u) / 8u;
const beside = select(width, 1u, along_x) * parts;  // from one pixel of the axis to the next

fn main(i) {
    if (i >= planes * select(width, height, along_x) * eights * parts) { return; }
    let part = i % parts;
    let rest = i / parts;
    // Neighbouring invocations have neighbouring columns.
    let along = 8u * select(rest / width % eights, rest % eights, along_x);
    let line = select(rest % width, rest / eights % height, along_x) * parts;
    let plane = rest / select(width * eights, eights * height, along_x);
    let first = plane * width * height * parts + line * select(1u, width, along_x) + part;
    var near = vec4f();  // of the first four and of the others: sums, and weights for what is read
    var far = vec4f();
    var near_weights = vec4f();
    var far_weights = vec4f();
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        far_weights = vec4f(near_weights.w, far_weights.xyz);
        near_weights = vec4f(taps[k], near_weights.xyz);
        let here = before[first + mirrored(i32(along + k) - i32(reach), across) * beside];
        near += near_weights * here;
        far += far_weights * here;
    }
    for (var n = 0u; n < 4u; n++) {
        if (along + n < across) { after[first + (along + n) * beside] = near[n]; }
        if (along + n + 4u < across) { after[first + (along + n + 4u) * beside] = far[n]; }
    }
}

// ---- layer_tangents: indexing
// Tangents of the log of the unexplained fraction at the last offset from the nearest layer; see
// `readable/between_layers.py`. Their averages give the next offset (`layer_offsets`).

in winner: array<vec3f>;
in offset: array<f32>;
out tangents: array<vec2f>;  // slope and bend

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let about = winner[pixel];
    let o = select(offset[pixel], 0.0, is_first);
    let unexplained = max(1.0 + o * (about.y + o * about.z), least_unexplained);
    tangents[pixel] = vec2f(about.y, 2.0 * about.z) / unexplained;
}

// ---- layer_offsets: indexing
// Offset from the nearest layer at which averaged tangents are least, half a layer at most, and the label there.

in winner: array<vec3f>;
in averaged: array<vec2f>;
out offset: array<f32>;
out label: array<f32>;

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let pull = averaged[pixel];
    let o = clamp(-pull.x / max(pull.y, 1.0e-9), -0.5, 0.5);  // 1e-9: even evidence
    offset[pixel] = o;
    label[pixel] = winner[pixel].x + o;
}

// ---- volume_posterior: indexing
// Mean and variance of the layers, each as probable as exp(-cost / temperature); layers. Moments are taken about the
// layer of least cost: about the first, float32 would lose a narrow variance.

in cost: array<f32>;  // (h, w, count)
out posterior: array<vec2f>;  // (h, w)

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let at = pixel * count;
    var best = 0u;
    var least = cost[at];
    for (var k = 1u; k < count; k++) {
        let here = cost[at + k];
        best = select(best, k, here < least);
        least = min(least, here);
    }
    var mass = 0.0;
    var moments = vec2f();
    for (var k = 0u; k < count; k++) {
        let probable = exp(-(cost[at + k] - least) / temperature);
        let away = f32(k) - f32(best);
        mass += probable;
        moments += probable * vec2f(away, away * away);
    }
    moments /= mass;
    posterior[pixel] = vec2f(f32(best) + moments.x, max(moments.y - moments.x * moments.x, 0.0));
}

// ---- block_means: indexing
// Means of a volume over squares of pixels, as far as these are usable; what is left over at the right and below is left
// out.

in of_pixels: array<f32>;  // (h, w, count)
in usable: array<f32>;  // (h / size, w / size)
out likelihood: array<f32>;  // (h / size, w / size, count)

fn main(i) {
    let across = width / size;
    if (i >= across * (height / size) * count) { return; }
    let block = i / count;
    let first = (block / across * size * width + block % across * size) * count + i % count;
    var sum = 0.0;
    for (var y = 0u; y < size; y++) {
        for (var x = 0u; x < size; x++) { sum += of_pixels[first + (y * width + x) * count]; }
    }
    likelihood[i] = usable[block] * sum / f32(size * size);
}
