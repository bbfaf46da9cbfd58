// A surface between the pixels of one of half its size: more of the neighbour whose guide is like a pixel's own, and one
// of the two where these lie on two surfaces. The guide starts at `guide_start`; `guide_scale` is the place of its unit
// in `stats`.

// Surfaces of two neighbours, and the guide here, before and after.
fn between(before: vec3f, after: vec3f, here_guide: f32, before_guide: f32, after_guide: f32) -> vec3f {
    let unit = stats[guide_scale];
    let to_before = (here_guide - before_guide) * unit;
    let to_after = (here_guide - after_guide) * unit;
    var weight = (1.0 + to_before * to_before) / (2.0 + to_before * to_before + to_after * to_after);
    if (is_known(before.x) && is_known(after.x) && abs(after.x - before.x) > jump_px) {
        weight = select(0.0, 1.0, weight > 0.5);
    }
    if (!is_known(after.x)) { weight = 0.0; }
    if (!is_known(before.x)) { weight = 1.0; }
    if (weight <= 0.0) { return before; }
    if (weight >= 1.0) { return after; }
    return before + weight * (after - before);
}

fn small(x: u32, y: u32) -> vec3f {
    return surface[y * half_width + min(x, half_width - 1u)].xyz;
}

// At a pixel of an even row.
fn wide(x: u32, y: u32) -> vec3f {
    if (x % 2u == 0u) { return small(x / 2u, y / 2u); }
    let row = guide_start + y * width;
    let after = guide[row + min(x + 1u, width - 1u)];
    return between(small(x / 2u, y / 2u), small(x / 2u + 1u, y / 2u), guide[row + x], guide[row + x - 1u], after);
}

fn surface_at(x: u32, y: u32) -> vec3f {
    let i = y * width + x;
    if (y % 2u == 0u) { return wide(x, y); }
    let below = select(y - 1u, y + 1u, y + 1u < height);
    let after = guide[guide_start + min(y + 1u, height - 1u) * width + x];
    return between(wide(x, y - 1u), wide(x, below), guide[guide_start + i], guide[guide_start + i - width], after);
}
