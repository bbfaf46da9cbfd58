// From filtered scores to disparity at quality paper.

// ---- running_winner: indexing, shared
// The best layer so far, from one chunk of filtered scores after the other, with the scores before and after it. Where
// it is an end of the range the disparity is unknown, and nobody reads the score beyond.

in maps: array<vec4f>;  // (h, w, pitch): scores times weights, weights
out best: array<f32>;  // (5, h, w): layer, before, at, after, last score

fn main(i) {
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

// ---- peak: indexing, shared
// A parabola through the best layer and its neighbours, and from its shape the error bar (quality "paper"), as
// `error_bar.peak_sigma`.

in best: array<f32>;  // (5, H, W): layer, before, at, after, last score
out peaks: array<f32>;  // (3, H, W): disparity, its error bar, score

fn main(i) {
    if (i >= pixels) { return; }
    let layer = best[i];
    let before = best[pixels + i];
    let at = best[2u * pixels + i];
    let after = best[3u * pixels + i];
    let bend = max(2.0 * at - before - after, 0.0);
    var offset = 0.0;
    var peak = at;
    if (bend > 1.0e-12) {  // a flat top has no vertex; scores are of order 1
        offset = clamp((after - before) / (2.0 * bend), -0.5, 0.5);
        peak = at + (after - before) * (after - before) / (8.0 * bend);
    }
    let curvature = max(bend / (step_px * step_px), 1.0e-9);
    let high = clamp(peak, 1.0e-3, 1.0 - 1.0e-6);  // a peak of 0 or 1 would make the variance infinite or 0
    var variance = (1.0 - high) / (samples * curvature);
    if (view_count == 2u) { variance *= (1.0 + high) / high; }
    let wide = min(sigma_scale * sqrt(variance), max_sigma_px);
    let known = layer > 0.0 && layer < f32(total_layers - 1u) && wide < range_sigma_px;
    peaks[i] = select(UNKNOWN, first_px + step_px * (layer + offset), known);
    peaks[pixels + i] = wide;
    peaks[2u * pixels + i] = peak;
}

// ---- peak_range_x: indexing, shared
// Lowest and highest known disparity along x (quality "paper"), for `peak_range`.

in peaks: array<f32>;  // (3, H, W): disparity, its error bar, score
out ranges: array<vec2f>;  // (H, W): lowest, highest

fn main(i) {
    if (i >= width * height) { return; }
    let x = i32(i % width);
    let first = i - i % width;
    var low = 1.0e30;
    var high = -1.0e30;
    for (var n = 0u; n < side; n++) {  // unrolled
        let here = peaks[first + inside(x + i32(n) - i32(reach), width)];
        low = min(low, here);
        high = max(high, select(-1.0e30, here, is_known(here)));  // unknown is larger than all that is known
    }
    ranges[i] = vec2f(low, high);
}

// ---- peak_range: indexing, shared, finishing
// The error bar of a peak, widened where the disparity varies around it and where the views differ by hue (quality
// "paper"), as `paper.py`.

in peaks: array<f32>;  // (3, H, W): disparity, its error bar, score
in ranges: array<vec2f>;  // (H, W): lowest and highest disparity along x
in unlike: array<f32>;  // (rows, columns): `unlike_share`
out disparity: array<u32>;  // (H, W)
out sigma: array<u32>;
out confidence: array<u32>;

// Linear between the cells' centres, as OpenCV's INTER_LINEAR.
fn unlike_at(x: u32, y: u32) -> f32 {
    let size = vec2f(f32(columns), f32(rows));
    let place = (vec2f(f32(x), f32(y)) + 0.5) * size / vec2f(f32(width), f32(height)) - 0.5;
    let held = clamp(place, vec2f(), size - 1.0);
    let before = vec2u(held);
    let after = min(before + 1u, vec2u(columns, rows) - 1u);
    let part = held - vec2f(before);
    let above = mix(unlike[before.y * columns + before.x], unlike[before.y * columns + after.x], part.x);
    let below = mix(unlike[after.y * columns + before.x], unlike[after.y * columns + after.x], part.x);
    return mix(above, below, part.y);
}

fn main(i) {
    let pixels = width * height;
    if (i >= pixels) { return; }
    let x = i % width;
    let y = i32(i / width);
    var low = 1.0e30;
    var high = -1.0e30;
    for (var n = 0u; n < side; n++) {  // unrolled
        let here = ranges[inside(y + i32(n) - i32(reach), height) * width + x];
        low = min(low, here.x);
        high = max(high, here.y);
    }
    let at_edge = edge_share * max(high - low, 0.0);
    let by_hue = hue_px * unlike_at(x, u32(y));
    let wide = min(length(vec4f(peaks[pixels + i], at_edge, by_hue, floor_px)), range_sigma_px);
    let maps = finished(i, peaks[i], wide, peaks[2u * pixels + i], 0.0);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}

// ---- unlike_moments: indexing, shared
// Mean and variance of the views, moved by the disparity that was found, and of their mean, in squares of `cell` px
// (quality "paper"), as `paper.py`.

in planes: array<f32>;  // (K + 2, H, W), of which the views
in peaks: array<f32>;  // (3, H, W), of which the disparity
out moments: array<vec4f>;  // (2, rows, columns): views first, their mean last

// Linear between pixels.
fn view_at(view: u32, place: vec2f) -> f32 {
    let held = clamp(place, vec2f(), vec2f(f32(width - 1u), f32(height - 1u)));
    let before = vec2u(held);
    let after = min(before + 1u, vec2u(width - 1u, height - 1u));
    let part = held - vec2f(before);
    let above = (view * height + before.y) * width;
    let below = (view * height + after.y) * width;
    return mix(
        mix(planes[above + before.x], planes[above + after.x], part.x),
        mix(planes[below + before.x], planes[below + after.x], part.x), part.y
    );
}

fn main(i) {
    if (i >= columns * rows) { return; }
    var first = vec4f();  // differences from it are exact where there is little texture
    var sums = vec4f();
    var squares = vec4f();
    for (var n = 0u; n < cell * cell; n++) {
        let x = min(cell * (i % columns) + n % cell, width - 1u);
        let y = min(cell * (i / columns) + n / cell, height - 1u);
        let disparity = peaks[y * width + x];
        let moved = select(0.0, disparity, is_known(disparity));
        var seen = vec4f();
        for (var k = 0u; k < view_count; k++) {
            let direction = vec2f(directions[2u * k], directions[2u * k + 1u]);
            seen[k] = view_at(k, vec2f(f32(x), f32(y)) + moved * direction);
            seen.w += seen[k] / f32(view_count);
        }
        if (n == 0u) { first = seen; }
        sums += seen - first;
        squares += (seen - first) * (seen - first);
    }
    let away = sums / f32(cell * cell);
    moments[i] = first + away;
    moments[columns * rows + i] = squares / f32(cell * cell) - away * away;
}

// ---- unlike_share: indexing, shared
// Which share of the views' variance in a window of cells is not that of their mean (quality "paper"), as
// `paper.unlike_share`.

in moments: array<vec4f>;  // (2, rows, columns): views first, their mean last
out share: array<f32>;  // (rows, columns)

fn main(i) {
    if (i >= columns * rows) { return; }
    let x = i32(i % columns) - i32(side / 2u);
    let y = i32(i / columns) - i32(side / 2u);
    let here = moments[i];  // differences from it are exact where there is little texture
    var mean = vec4f();
    var square = vec4f();
    for (var n = 0u; n < side * side; n++) {
        let at = inside(y + i32(n / side), rows) * columns + inside(x + i32(n % side), columns);
        let away = moments[at] - here;
        mean += away / f32(side * side);
        square += (away * away + moments[columns * rows + at]) / f32(side * side);
    }
    let variances = max(square - mean * mean, vec4f());
    let total = (variances.x + variances.y + variances.z) / f32(view_count);
    share[i] = clamp((total - variances.w) / (total + least_variance), 0.0, 1.0);
}
