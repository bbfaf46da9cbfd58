// From likelihoods to disparity at quality real-time.

// ---- lanes_quad
// Four invocations share a path: each holds every fourth vector of four layers, and the least cost goes round the quad.
const lanes = 4u;
var<private> lane_here: u32;

fn least_of_lanes(own: f32) -> f32 {
    let pair = min(own, quadSwapX(own));
    return min(pair, quadSwapY(pair));
}

// ---- lanes_shared
// The form of `lanes_quad` for devices without subgroups: the least cost goes through shared memory.
const lanes = 4u;

var<workgroup> lane_costs: array<f32, 64>;
var<private> lane_here: u32;

fn least_of_lanes(own: f32) -> f32 {
    workgroupBarrier();
    lane_costs[lane_here] = own;
    workgroupBarrier();
    let quad = lane_here & ~3u;
    return min(min(lane_costs[quad], lane_costs[quad + 1u]), min(lane_costs[quad + 2u], lane_costs[quad + 3u]));
}

// ---- packed_costs
// Path costs as whole parts of a nat in 16 bits. The CPU rounds sums of two to the same parts.

fn packed(costs: vec4f) -> vec2u {
    let whole = vec4u(round(cost_parts * costs));
    return whole.xz | (whole.yw << vec2u(16u));
}

fn unpacked(words: vec2u) -> vec4f {
    return vec4f(vec4u(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu, words.y >> 16u));
}

// ---- own_of_rows
// What a pixel costs by itself, and what it is computed from.

struct Own { likelihood: vec4f }

fn own_read(at: u32) -> Own {
    return Own(likelihood[at]);
}

fn own_cost(own: Own) -> vec4f {
    return -own.likelihood;
}

// ---- own_of_columns
// What a pixel costs by itself, and a share of what comes along its row; and what it is computed from.

@group(0) @binding(4) var<storage, read> rightward: array<vec2u>;
@group(0) @binding(5) var<storage, read> leftward: array<vec2u>;

struct Own { likelihood: vec4f, rightward: vec2u, leftward: vec2u }

fn own_read(at: u32) -> Own {
    return Own(likelihood[at], rightward[at], leftward[at]);
}

fn own_cost(own: Own) -> vec4f {
    return row_share / row_parts * (unpacked(own.rightward) + unpacked(own.leftward)) - own.likelihood;
}

// ---- four_paths: indexing, shared
// Path costs along one of four directions: 0 right, 1 left, 2 down, 3 up. A pixel of path cost c adds to its neighbour
// on the path m = min(c, min c + e jump) - min c, which is left in 16 bits for `path_winner`. The
// dispatches write to arrays of their own, so that a device may run both rows, and both columns, side by side. What is a
// pixel's own is in `own_of_rows` and `own_of_columns`. A step computes little and would wait for the memory:
// what it needs is read `ahead` steps before.

in likelihood: array<vec4f>;  // (h, w, pitch / 4)
in guide: array<f32>;  // planes; the guide is the one behind K others
in stats: array<f32>;
out costs: array<vec2u>;  // (h, w, pitch / 4)

const pixel_vectors = pitch / 4u;

fn pixel_of(s: u32, line: u32, steps: u32) -> u32 {
    let along = select(s, steps - 1u - min(s, steps - 1u), (direction & 1u) == 1u);
    let inside = min(along, steps - 1u);
    return select(inside * width + line, line * width + inside, direction < 2u);
}

fn main(group, local) {
    let line_count = select(width, height, direction < 2u);
    let steps = select(height, width, direction < 2u);
    lane_here = local;
    let line = group.x * (64u / lanes) + local / lanes;
    let lane = local % lanes;
    let used = line < line_count;
    let here = min(line, line_count - 1u);
    var own: array<Own, ahead * vectors>;
    var own_guide: array<f32, ahead>;
    for (var j = 0u; j < ahead; j++) {  // unrolled
        let pixel = pixel_of(j, here, steps);
        own_guide[j] = guide[guide_plane + pixel];
        for (var v = 0u; v < vectors; v++) {  // unrolled
            own[j * vectors + v] = own_read(pixel * pixel_vectors + min(v * lanes + lane, pixel_vectors - 1u));
        }
    }
    var cost: array<vec4f, vectors>;
    var least = 0.0;
    var before_guide = 0.0;
    let edge = stats[GUIDE_SCALE] / edge_range;
    for (var s = 0u; s < steps; s += ahead) {
        for (var j = 0u; j < ahead; j++) {  // unrolled
            if (s + j >= steps) { break; }
            let pixel = pixel_of(s + j, here, steps);
            let next = pixel_of(s + j + ahead, here, steps);
            let link = edge_floor + (1.0 - edge_floor) * exp(-abs(own_guide[j] - before_guide) * edge);
            let limit = select(least + link * jump, 0.0, s + j == 0u);
            before_guide = own_guide[j];
            own_guide[j] = guide[guide_plane + next];
            var lowest = vec4f(1.0e30);
            for (var v = 0u; v < vectors; v++) {  // unrolled
                if ((v + 1u) * lanes <= pixel_vectors || v * lanes + lane < pixel_vectors) {
                    let at = v * lanes + lane;
                    let own_here = own[j * vectors + v];
                    own[j * vectors + v] = own_read(next * pixel_vectors + at);
                    let incoming = select(min(cost[v], vec4f(limit)) - least, vec4f(), s + j == 0u);
                    if (used) { costs[pixel * pixel_vectors + at] = packed(incoming); }
                    cost[v] = incoming + own_cost(own_here);
                    lowest = min(lowest, cost[v]);
                }
            }
            least = least_of_lanes(min(min(lowest.x, lowest.y), min(lowest.z, lowest.w)));
        }
    }
}

// ---- path_winner: indexing, shared, packed_costs
// The best layer of every pixel by the sum of its path costs, how sharp it is, and where between the layers the pixel's
// own correlations have their peak.

in likelihood: array<vec4f>;  // (h, w, pitch / 4)
in rightward: array<vec2u>;
in leftward: array<vec2u>;
in downward: array<vec2u>;
in upward: array<vec2u>;
out winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
out places: array<vec2f>;  // (h, w): information, place times information

fn likelihood_of(pixel: u32, layer: u32) -> f32 {
    return likelihood[pixel * (pitch / 4u) + layer / 4u][layer % 4u];
}

// The correlation behind a log-likelihood.
fn correlation_of(nats: f32) -> f32 {
    if (view_count == 2u) { return sqrt(max(1.0 - exp(-2.0 * nats), 0.0)); }
    return 1.0 - exp(-nats);
}

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    var costs: array<vec4f, pitch / 4u>;
    var least = 1.0e30;
    var best = 0u;
    for (var v = 0u; v < pitch / 4u; v++) {
        let at = pixel * (pitch / 4u) + v;
        let others = unpacked(rightward[at]) + unpacked(leftward[at]) + unpacked(downward[at]);
        let cost = others / row_parts + (unpacked(upward[at]) / cost_parts - likelihood[at]);
        costs[v] = cost;
        for (var j = 0u; j < 4u; j++) {
            if (cost[j] < least) {
                least = cost[j];
                best = 4u * v + j;
            }
        }
    }
    var weights = 0.0;
    var squares = 0.0;
    for (var v = 0u; v < pitch / 4u; v++) {
        var weight = max(1.0 - (costs[v] - least) / (8.0 * temperature), vec4f());
        weight *= weight;
        weight *= weight;
        weight *= weight;
        // Layers that only fill the last vector are none. They have no likelihood, so that none of them is the best.
        weight = select(vec4f(), weight, vec4u(0u, 1u, 2u, 3u) + 4u * v < vec4u(layer_count));
        let away = vec4f(0.0, 1.0, 2.0, 3.0) + f32(4u * v) - f32(best);
        weights += dot(weight, vec4f(1.0));
        squares += dot(weight, away * away);
    }
    let middle = clamp(best, 1u, layer_count - 2u);
    let at = likelihood_of(pixel, middle);
    winner[pixel] = f32(best);
    winner[width * height + pixel] = at;
    winner[2u * width * height + pixel] = sqrt(squares / weights);

    let low = correlation_of(likelihood_of(pixel, middle - 1u));
    let here = correlation_of(at);
    let high = correlation_of(likelihood_of(pixel, middle + 1u));
    var offset = 0.0;
    var information = least_information;
    if (view_count == 2u) {
        let bend = max(2.0 * here - low - high, 0.0);
        offset = clamp((high - low) / (2.0 * bend + 1.0e-9), -1.0, 1.0);  // 1e-9: a flat top has no vertex
        let peak = min(here + offset * (high - low) / 4.0, 1.0);
        let found = bend * peak / (1.0 - peak * peak + least_unexplained);
        information += found * sqrt(sqrt(found));
    } else {
        // Where the range ends one layer away the parabola through the three others goes on.
        var far_low = 3.0 * (low - here) + high;
        var far_high = 3.0 * (high - here) + low;
        if (middle > 1u) { far_low = correlation_of(likelihood_of(pixel, middle - 2u)); }
        if (middle < layer_count - 2u) { far_high = correlation_of(likelihood_of(pixel, middle + 2u)); }
        let rise = (2.0 * (far_high - far_low) + high - low) / 5.0;
        let least_bend = abs(rise) / (2.0 * farthest_of_five);
        let bend = max((2.0 * here + low + high - 2.0 * (far_low + far_high)) / 7.0, least_bend);
        offset = rise / (2.0 * bend + 1.0e-9);
        information += bend * here / (1.0 - here + least_unexplained_of_three);
    }
    places[pixel] = vec2f(information, (f32(middle) + offset) * information);
}

// ---- beside_nearer: indexing, shared
// Cells beside nearer things know less of their place: `readable/place.py`, `BESIDE_NEARER`.

in winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
out places: array<vec2f>;  // (h, w): information, place times information

fn main(group, groups, local) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let x = pixel % width;
    let y = pixel / width;
    var nearest = winner[pixel];
    for (var v = max(y, nearer_reach) - nearer_reach; v <= min(y + nearer_reach, height - 1u); v++) {
        for (var u = max(x, nearer_reach) - nearer_reach; u <= min(x + nearer_reach, width - 1u); u++) {
            nearest = min(nearest, winner[v * width + u]);
        }
    }
    if (winner[pixel] - nearest > 1.0) { places[pixel] *= weight; }
}

// ---- surface: indexing, shared, half_labels
// From the smoothed places between the layers to the surface of the halved picture: its disparity in half px, and
// highest and lowest disparity along x, of which `surface_range` makes the range about each pixel.
// One invocation takes four neighbours, whose ranges overlap.

in places: array<vec2f>;  // (h, w): information, place times information
in labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
out ranges: array<vec2f>;  // (h, w): lowest, highest

fn disparity_at(x: u32, y: u32) -> f32 {
    let sums = places[y * width + x];
    let label = half_label(x, y);
    return label.x + label.y * (first_px + step_px * sums.y / sums.x);
}

fn main(i) {
    let each = (width + 3u) / 4u;  // invocations of a row
    if (i >= each * height) { return; }
    let first = 4u * (i % each);
    let y = i / each;
    var low = vec4f(1.0e30);
    var high = vec4f(-1.0e30);
    for (var n = 0u; n < 2u * reach + 4u; n++) {
        let here = disparity_at(inside(i32(first + n) - i32(reach), width), y);
        let is_near = (vec4u(n) >= vec4u(0u, 1u, 2u, 3u)) & (vec4u(n) <= 2u * reach + vec4u(0u, 1u, 2u, 3u));
        low = select(low, min(low, vec4f(here)), is_near);
        high = select(high, max(high, vec4f(here)), is_near);
    }
    for (var n = 0u; n < min(4u, width - first); n++) { ranges[y * width + first + n] = vec2f(low[n], high[n]); }
}

// ---- surface_range: indexing, shared, half_labels
// The surface of the halved picture: disparity, sigma, peak, in px of the full one. Unknown where the best layer is an
// end of the range, where it is known hardly better than the range, and where no usable pixel is near. One invocation
// takes four neighbours along y, whose ranges overlap.

in ranges: array<vec2f>;  // (h, w): lowest and highest disparity along x
in places: array<vec2f>;  // (h, w): information, place times information
in winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
in labels: array<f32>;  // (2, H, W) or (2, 1, 1)
in planes: array<f32>;  // the mask is the one behind K + 1 others
out surface: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing

fn is_near_usable(x: u32, y: u32) -> bool {
    let far = i32(seen_reach);
    var usable = 0.0;
    for (var row = -far; row <= far; row++) {
        let start = mask_plane + inside(i32(y) + row, height) * width;
        for (var column = -far; column <= far; column++) { usable += planes[start + inside(i32(x) + column, width)]; }
    }
    return usable > 0.0;
}

// A pixel of such a range.
fn finish(x: u32, y: u32, range: f32) {
    let i = y * width + x;
    let label = half_label(x, y);
    let scale = label.y;
    let disparity = label.x + scale * (first_px + step_px * places[i].y / places[i].x);
    let posterior = step_px * winner[2u * width * height + i];
    var known = winner[i] > 0.0 && winner[i] < f32(layer_count - 1u) && posterior < widest_share * widest_px;
    known = known && is_near_usable(x, y);
    let information = places[i].x;
    let own = scale * step_px * sqrt((scatter * scatter + bias * bias / information) / information);
    let sigma = min(length(vec2f(own, edge_share * range)), scale * widest_px);
    let peak = sqrt(max(1.0 - exp(-2.0 * winner[width * height + i]), 0.0));
    surface[i] = vec4f(select(UNKNOWN, 2.0 * disparity, known), 2.0 * sigma, peak, 0.0);
}

fn main(i) {
    if (i >= ((height + 3u) / 4u) * width) { return; }
    let x = i % width;
    let first = 4u * (i / width);
    var low = vec4f(1.0e30);
    var high = vec4f(-1.0e30);
    for (var n = 0u; n < 2u * reach + 4u; n++) {
        let here = ranges[inside(i32(first + n) - i32(reach), height) * width + x];
        let is_near = (vec4u(n) >= vec4u(0u, 1u, 2u, 3u)) & (vec4u(n) <= 2u * reach + vec4u(0u, 1u, 2u, 3u));
        low = select(low, min(low, vec4f(here.x)), is_near);
        high = select(high, max(high, vec4f(here.y)), is_near);
    }
    for (var n = 0u; n < min(4u, height - first); n++) { finish(x, first + n, high[n] - low[n]); }
}

// ---- enlarge: indexing, shared, between, finishing
// The surface of the halved picture at every pixel, by `between`.

in surface: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing
in guide: array<f32>;  // (H, W)
in stats: array<f32>;
in labels: array<f32>;  // (2, H, W) or (2, 1, 1)
in lacking: array<f32>;  // (cells_y, cells_x)
out disparity: array<u32>;  // (H, W)
out sigma: array<u32>;
out confidence: array<u32>;

fn main(i) {
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    let found = surface_at(x, y);
    var least_sigma = 0.0;
    if (lacking[(y * cells_y / height) * cells_x + x * cells_x / width] > 0.0) {
        var scale = 1.0;
        if (labelled) { scale = labels[width * height + i]; }
        least_sigma = min(scale * range_sigma_px, max_sigma_px);
    }
    let maps = finished(i, found.x, length(vec2f(found.y, floor_px)), found.z, least_sigma);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
