// For `conversion.wgsl`: A, B, delta and six covariances of frames for which maps of them would take too much memory,
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
