// Costs of all paths of one direction (dx, dy) through a volume of log-likelihoods, added to `total`; see
// `readable/paths.py`. A path is walked by `lanes` invocations, each of which holds `own_layers` neighbouring layers.
// The least of L(q, e) + slope |d - e| over e is a scan up and one down the layers of an invocation; what comes from
// other invocations travels through shared memory together with the least cost, with one barrier a pixel. A step computes
// little and would wait for the memory: what it needs is read `ahead` steps before.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count) nats
@group(0) @binding(1) var<storage, read> guide: array<f32>;  // (h, w), in units of guide_range
@group(0) @binding(2) var<storage, read_write> total: array<f32>;  // (h, w, count)

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

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
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
