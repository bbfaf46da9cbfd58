// Disparity to millimetres.

// ---- fields_mapped
// For `conversion`: A, B, delta and six covariances lie behind one another, each (H, W) or one number.

fn field(number: u32, i: u32) -> f32 {
    return fields[u32(field_at[number]) + select(0u, i, field_is_map[number] > 0.0)];
}

// ---- fields_smooth
// For `conversion`: A, B, delta and six covariances of frames for which maps of them would take too much memory,
// as `DepthField.model` computes them. In `fields` lie the coefficients of A and B, the grids of their corrections, and
// those of the covariances.

const frame_last = vec2f(frame_last_px[0], frame_last_px[1]);
const of_curve = field_side * field_side;
const of_local = local_rows * local_columns;
const of_nodes = node_rows * node_columns;

// Bilinear between the points of a grid, constant beyond it.
fn on_grid(first: u32, columns: u32, rows: u32, place: vec2f) -> f32 {
    let last = vec2f(f32(columns - 1u), f32(rows - 1u));
    let at = clamp(place, vec2f(), last);
    let low = min(vec2u(at), vec2u(max(last - 1.0, vec2f())));
    let part = at - vec2f(low);
    let high = min(low + 1u, vec2u(last));
    let above = mix(fields[first + low.y * columns + low.x], fields[first + low.y * columns + high.x], part.x);
    let below = mix(fields[first + high.y * columns + low.x], fields[first + high.y * columns + high.x], part.x);
    return mix(above, below, part.y);
}

// Sum of the products T_i(u) T_j(v).
fn polynomial(first: u32, u: f32, v: f32) -> f32 {
    var sum = 0.0;
    var before_x = u;  // T_-1
    var here_x = 1.0;
    for (var i = 0u; i < field_side; i++) {
        var inner = 0.0;
        var before_y = v;
        var here_y = 1.0;
        for (var j = 0u; j < field_side - i; j++) {
            inner += fields[first + i * field_side + j] * here_y;
            let next = 2.0 * v * here_y - before_y;
            before_y = here_y;
            here_y = next;
        }
        sum += inner * here_x;
        let next = 2.0 * u * here_x - before_x;
        before_x = here_x;
        here_x = next;
    }
    return sum;
}

fn field(number: u32, i: u32) -> f32 {
    if (number == 2u) { return pupil_mm; }
    let place = vec2f(f32(i % width), f32(i / width));
    if (number > 2u) {
        let node = place * vec2f(f32(node_columns - 1u), f32(node_rows - 1u)) / frame_last;
        return on_grid(2u * (of_curve + of_local) + (number - 3u) * of_nodes, node_columns, node_rows, node);
    }
    let unit = (2.0 * place - frame_last) / frame_last;
    let local = on_grid(2u * of_curve + number * of_local, local_columns, local_rows, (place - local_start) / local_step);
    return polynomial(number * of_curve, unit.x, unit.y) + local;
}

// ---- conversion: indexing, shared
// Disparity to millimetres with the curve of every pixel, depth = B / (A - d) + delta, and the error bar of both.

in disparity: array<u32>;  // (H, W)
in sigma: array<u32>;  // (H, W)
in fields: array<f32>;  // of which `field` makes A, B, delta and six covariances
in curve: array<f32>;  // (table_count, 5): linear disparity, four errors
out depth_mm: array<u32>;  // (H, W)
out sigma_mm: array<u32>;  // (H, W)

// d measured / d linear disparity: Clenshaw's rule for Chebyshev polynomials.
fn slope_at(linear: f32) -> f32 {
    if (linear <= low_px || linear >= high_px) { return 1.0; }
    let s = (2.0 * linear - low_px - high_px) / (high_px - low_px);
    var c0 = slope[slope_count - 2u];
    var c1 = slope[slope_count - 1u];
    for (var n = i32(slope_count) - 3i; n >= 0i; n--) {
        let before = c0;
        c0 = slope[n] - c1;
        c1 = before + c1 * 2.0 * s;
    }
    return 1.0 + (c0 + c1 * s);
}

fn main(i) {
    if (i >= pixels) { return; }
    depth_mm[i] = NAN_BITS;
    sigma_mm[i] = NAN_BITS;
    if (disparity[i] == NAN_BITS) { return; }
    var d = bitcast<f32>(disparity[i]);
    let a = field(0u, i);
    let b = field(1u, i);
    let delta = field(2u, i);
    var k = 0u;
    var part = 0.0;
    if (table_count > 1u) {
        let place = clamp((d - first_px) * per_px, 0.0, f32(table_count - 1u));
        k = min(u32(place), table_count - 2u);
        part = place - f32(k);
        let beyond = min(d - first_px, 0.0) + max(d - last_px, 0.0);  // slope 1 outside
        d = curve[5u * k] + part * (curve[5u * k + 5u] - curve[5u * k]) + beyond;
    }
    if ((a - d) * (max_depth_mm - delta) < b) { return; }  // at infinity, or too far
    let by_b = 1.0 / (a - d);
    let z = b * by_b;
    let by_d = z * by_b;
    var by_reading = by_d;
    if (table_count > 1u) { by_reading = by_d / slope_at(d); }
    var variance = by_d * (by_d * field(3u, i) - 2.0 * (field(5u, i) + by_b * field(4u, i)))
        + by_b * (by_b * field(6u, i) + 2.0 * field(7u, i)) + field(8u, i);
    if (has_errors) {
        let at = 5u * k + 1u;
        let here = vec4f(curve[at], curve[at + 1u], curve[at + 2u], curve[at + 3u]);
        let next = vec4f(curve[at + 5u], curve[at + 6u], curve[at + 7u], curve[at + 8u]);
        let errors = here + part * (next - here);
        variance += by_reading * (by_reading * errors.x + 2.0 * (by_d * errors.y - by_b * errors.z - errors.w));
    }
    let of_reading = by_reading * bitcast<f32>(sigma[i]);
    depth_mm[i] = bitcast<u32>(z + delta);
    sigma_mm[i] = bitcast<u32>(sqrt(of_reading * of_reading + max(variance, 0.0)));
}
