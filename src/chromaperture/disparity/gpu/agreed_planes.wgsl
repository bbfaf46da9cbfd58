// Planes that points of a tile agree on, by random samples; see `plane_fit.py` and `stages.agreed_plane`. A workgroup has
// a tile and finds one plane after the other in what is left of its points. Planes count in layers, from the tile's corner.

@group(0) @binding(0) var<storage, read> label: array<f32>;  // (h, w), layers
@group(0) @binding(1) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(2) var<storage, read> tiles: array<vec4u>;  // of each two: top, left, rows, columns; every, first point
@group(0) @binding(3) var<storage, read> draws: array<u32>;  // (tiles, rounds, trials, 3)
@group(0) @binding(4) var<storage, read_write> left: array<vec4f>;  // (2, points): x, y, label, weight
@group(0) @binding(5) var<storage, read_write> points: array<u32>;  // (points,): x and y of those that agree
@group(0) @binding(6) var<storage, read_write> parts: array<vec4u>;  // (tiles, rounds): see `plane_refining.wgsl`
@group(0) @binding(7) var<storage, read_write> planes: array<vec4f>;  // (tiles, rounds): from the middle of their points

var<workgroup> votes: array<f32, trials>;
var<workgroup> squares: array<vec4f, lanes>;  // weighted: xx, xy, yy, 1
var<workgroup> products: array<vec4f, lanes>;  // x, y, x label, y label
var<workgroup> others: array<vec2f, lanes>;  // label; points, not weighted

fn plane_through(first: vec3f, second: vec3f, third: vec3f) -> vec4f {
    let one = second - first;
    let other = third - first;
    let area = one.x * other.y - one.y * other.x;
    let is_wide = abs(area) > least_area;
    let a = (one.z * other.y - one.y * other.z) / select(1.0, area, is_wide);
    let b = (one.x * other.z - one.z * other.x) / select(1.0, area, is_wide);
    return vec4f(a, b, first.z - a * first.x - b * first.y, select(0.0, 1.0, is_wide));
}

fn tried(tile: u32, round: u32, trial: u32, start: u32, count: u32) -> vec4f {
    let at = ((tile * rounds + round) * trials + trial) * 3u;
    return plane_through(
        left[start + ((draws[at] * count) >> draw_bits)].xyz, left[start + ((draws[at + 1u] * count) >> draw_bits)].xyz,
        left[start + ((draws[at + 2u] * count) >> draw_bits)].xyz
    );
}

fn away(plane: vec3f, point: vec4f) -> f32 {
    return abs(dot(plane, vec3f(point.xy, 1.0)) - point.z);
}

@compute @workgroup_size(lanes)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let corner = tiles[2u * group.x];
    let every = tiles[2u * group.x + 1u].x;
    let first = tiles[2u * group.x + 1u].y;
    let all = corner.z * corner.w;
    for (var i = local; i < all; i += lanes) {
        let y = i / corner.w * every;
        let x = i % corner.w * every;
        let pixel = (corner.x + y) * width + corner.y + x;
        left[first + i] = vec4f(f32(x), f32(y), label[pixel], 1.0 / (sigma[pixel] * sigma[pixel] + 0.25));
    }
    storageBarrier();
    workgroupBarrier();
    var count = all;
    var start = first;
    var next = first + point_count;
    var taken = 0u;
    for (var round = 0u; round < rounds; round++) {
        if (f32(count) < max(least_left, least_share * f32(all))) { count = 0u; }
        for (var trial = local; trial < trials; trial += lanes) {
            var earned = -1.0;
            if (count > 0u) {
                let plane = tried(group.x, round, trial, start, count);
                if (plane.w > 0.5) {
                    earned = 0.0;
                    for (var i = 0u; i < count; i++) {
                        let point = left[start + i];
                        let gap = away(plane.xyz, point) / tolerance;
                        earned += max(0.0, 1.0 - gap * gap) * point.w;
                    }
                }
            }
            votes[trial] = earned;
        }
        workgroupBarrier();
        var best = 0u;
        for (var trial = 1u; trial < trials; trial++) { best = select(best, trial, votes[trial] > votes[best]); }
        var is_found = votes[best] >= 0.0;
        var plane = vec3f();
        if (is_found) { plane = tried(group.x, round, best, start, count).xyz; }
        let each = (count + lanes - 1u) / lanes;  // points of an invocation, next to each other
        let low = min(start + local * each, start + count);
        let high = min(low + each, start + count);
        // From the middle of the tile: sums of squares from its corner would lose digits.
        let middle = 0.5 * f32(every) * vec2f(corner.wz);
        for (var fit = 0u; fit < fits; fit++) {
            var square = vec4f();
            var product = vec4f();
            var other = vec2f();
            for (var i = low; i < high; i++) {
                let point = left[i];
                if (away(plane, point) < near * tolerance) {
                    let at = point.xy - middle;
                    square += point.w * vec4f(at.x * at.x, at.x * at.y, at.y * at.y, 1.0);
                    product += point.w * vec4f(at, at * point.z);
                    other += vec2f(point.w * point.z, 1.0);
                }
            }
            workgroupBarrier();
            squares[local] = square;
            products[local] = product;
            others[local] = other;
            workgroupBarrier();
            square = squares[0];
            product = products[0];
            other = others[0];
            for (var k = 1u; k < lanes; k++) {
                square += squares[k];
                product += products[k];
                other += others[k];
            }
            // About the middle of the points two slopes are left to be found.
            let weight = max(square.w, 1.0e-30);
            let mean = product.xy / weight;
            let xx = square.x - mean.x * product.x;
            let xy = square.y - mean.x * product.y;
            let yy = square.z - mean.y * product.y;
            let x = product.z - mean.x * other.x;
            let y = product.w - mean.y * other.x;
            let determinant = xx * yy - xy * xy;
            is_found = is_found && other.y >= least_points && determinant > 1.0e-6 * xx * yy;
            if (is_found) {
                let slopes = vec2f(x * yy - y * xy, y * xx - x * xy) / determinant;
                plane = vec3f(slopes, other.x / weight - dot(slopes, mean + middle));
            }
        }
        var agreeing = 0u;
        var sum = vec2f();
        for (var i = low; i < high; i++) {
            if (is_found && away(plane, left[i]) < near * tolerance) {
                agreeing += 1u;
                sum += left[i].xy;
            }
        }
        workgroupBarrier();
        others[local] = vec2f(f32(agreeing), 0.0);
        products[local] = vec4f(sum, 0.0, 0.0);
        workgroupBarrier();
        var before = 0u;  // of the invocations before this one
        var total = 0u;
        sum = vec2f();
        for (var k = 0u; k < lanes; k++) {
            before += select(0u, u32(others[k].x), k < local);
            total += u32(others[k].x);
            sum += products[k].xy;
        }
        var at = first + taken + before;
        var kept = next + (low - start) - before;
        for (var i = low; i < high; i++) {
            let point = left[i];
            if (is_found && away(plane, point) < near * tolerance) {
                points[at] = (corner.y + u32(point.x)) | ((corner.x + u32(point.y)) << 16u);
                at++;
            } else {
                left[kept] = point;
                kept++;
            }
        }
        let is_large = is_found && f32(total) >= least_share * f32(all);
        if (local == 0u) {
            let mean = sum / max(f32(total), 1.0);
            let slot = group.x * rounds + round;
            let from_corner = bitcast<vec2u>(mean + vec2f(corner.yx));
            parts[slot] = vec4u(first + taken, select(0u, total, is_large), from_corner);
            planes[slot] = vec4f(plane.xy, dot(plane, vec3f(mean, 1.0)), 0.0);
        }
        taken += select(0u, total, is_large);
        count = select(0u, count - total, is_found);
        let swapped = start;
        start = next;
        next = swapped;
        storageBarrier();
        workgroupBarrier();
    }
}
