// Where each channel sees a pixel of the centre view, and the depth buffer of the channel's view.

// Displacement of a channel per px of disparity.
fn direction_of(k: u32) -> vec2f {
    if (k == 0u) { return vec2f(directions[0], directions[1]); }
    if (k == 1u) { return vec2f(directions[2], directions[3]); }
    return vec2f(directions[4], directions[5]);
}

fn is_still(k: u32) -> bool {
    return length(direction_of(k)) < still;
}

// Place in the channel's view, -1 outside; rounded as `color/visibility.py` rounds.
fn place_in(k: u32, x: u32, y: u32, disparity: f32) -> i32 {
    let direction = direction_of(k);
    var at = vec2i(i32(x), i32(y));
    if (abs(direction.y) < still) {
        at.x = i32(clamp(f32(x) + disparity * direction.x, -2.0, f32(width + 1u)) + 4.5) - 4i;
    } else {
        let moved = vec2f(f32(x), f32(y)) + disparity * direction;
        at = vec2i(floor(clamp(moved, vec2f(-2.0), vec2f(f32(width) + 1.0, f32(height) + 1.0)) + 0.5));
    }
    let seen = at.x >= 0i && at.x < i32(width) && at.y >= 0i && at.y < i32(height);
    return select(-1i, at.y * i32(width) + at.x, seen);
}

// Unsigned integers, the larger the nearer (the smaller the disparity), above 0.
fn nearness(disparity: f32) -> u32 {
    let bits = bitcast<u32>(disparity);
    return ~select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn disparity_of(nearness: u32) -> f32 {
    let ordered = ~nearness;
    return bitcast<f32>(select(~ordered, ordered & 0x7fffffffu, (ordered & 0x80000000u) != 0u));
}
