// For `channels_shifted.wgsl`: channels are displaced by what a lens does (`color/lens_shift.py`), and sampled by Lanczos'
// filter, as OpenCV does it (at places rounded to 1 / 32 px), or by cubics.

@group(0) @binding(5) var<storage, read> table: array<f32>;  // (table_rows, table_columns, table_radii, 6), px
@group(0) @binding(6) var<storage, read> lanczos: array<f32>;  // (32, 8): weights at -3 to 4, of 32 places between pixels

const PLACES = 32;

// Linear between the entries of the table, constant beyond its radii.
fn displacement(x: u32, y: u32, k: u32, disparity: f32) -> vec2f {
    let v = f32(y) * f32(table_rows - 1u) / f32(max(height - 1u, 1u));
    let u = f32(x) * f32(table_columns - 1u) / f32(max(width - 1u, 1u));
    let radius = at_zero_px + per_px * disparity;
    let t = clamp((radius - first_radius_px) / radius_step_px, 0.0, f32(table_radii - 1u));
    let cell = min(vec2u(u32(u), u32(v)), vec2u(table_columns - 2u, table_rows - 2u));
    let n = min(u32(t), table_radii - 2u);
    let part = vec2f(u, v) - vec2f(cell);
    var total = vec2f();
    for (var corner = 0u; corner < 4u; corner++) {
        let to = vec2u(corner % 2u, corner / 2u);
        let weight = select(1.0 - part, part, to == vec2u(1u));
        let at = (((cell.y + to.y) * table_columns + cell.x + to.x) * table_radii + n) * 6u + 2u * k;
        let a = vec2f(table[at], table[at + 1u]);
        let b = vec2f(table[at + 6u], table[at + 7u]);
        total += weight.x * weight.y * (a + (t - f32(n)) * (b - a));
    }
    return lens_factor * total;
}

fn lanczos_at(moved: vec2f, k: u32) -> f32 {
    let place = vec2i(round(f32(PLACES) * clamp(moved, vec2f(-8.0), vec2f(f32(width), f32(height)) + 8.0)));
    let first = place >> vec2u(5u);
    let between = vec2u(place - PLACES * first);
    var sum = 0.0;
    for (var row = 0u; row < 8u; row++) {
        let line = inside(first.y + i32(row) - 3i, height) * width;
        var of_row = 0.0;
        for (var column = 0u; column < 8u; column++) {
            let value = image[3u * (line + inside(first.x + i32(column) - 3i, width)) + k];
            if (!is_finite(value)) { return UNKNOWN; }
            of_row += lanczos[8u * between.x + column] * value;
        }
        sum += lanczos[8u * between.y + row] * of_row;
    }
    return sum;
}

fn sample(x: u32, y: u32, k: u32, disparity: f32) -> f32 {
    let moved = vec2f(f32(x), f32(y)) + displacement(x, y, k, disparity);
    if (by_lanczos) { return lanczos_at(moved, k); }
    return cubic_at(moved, k);
}
