// Where a line across a border of a near plane may tell its place; see `plane_edges.border_lines`.

struct Border {
    is_heard: bool,
    near: u32,
    far: u32,
    near_first: bool,
    of_pair: u32,  // which of the points between the places of the edge lie on either plane, one bit each
}

// Of grid point i, to the right; of i - width * height downwards.
fn border_at(i: u32) -> Border {
    let down = i >= width * height;
    let point = select(i, i - width * height, down);
    let place = select(point % width, point / width, down);
    let length = select(width, height, down);
    let stride = select(1u, width, down);
    var out = Border();
    if (place + 1u < half || place + half >= length) { return out; }
    let here = choice[point];
    let beyond = choice[point + stride];
    let terms = vec4f(f32(point % width), f32(point / width), 1.0, 0.0);
    let gap = dot(planes[beyond], terms) - dot(planes[here], terms);  // labels grow with distance
    if (here == beyond || abs(gap) <= apart) { return out; }
    out.near_first = gap > 0.0;
    out.near = select(beyond, here, out.near_first);
    out.far = select(here, beyond, out.near_first);
    var number = 0u;
    for (var step = 0u; step < 2u * shifts + 2u; step++) {
        let other = choice[point + step * stride - shifts * stride];
        let is_of_pair = other == out.near || other == out.far;
        number += select(0u, 1u, is_of_pair);
        if (is_of_pair && step > 0u && step <= 2u * shifts) { out.of_pair |= 1u << (step - 1u); }
    }
    out.is_heard = f32(number) >= least_of_pair * f32(2u * shifts + 2u);
    return out;
}
