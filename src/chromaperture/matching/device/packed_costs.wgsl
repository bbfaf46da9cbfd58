// Path costs as whole parts of a nat in 16 bits. The CPU rounds sums of two to the same parts.

fn packed(costs: vec4f) -> vec2u {
    let whole = vec4u(round(cost_parts * costs));
    return whole.xz | (whole.yw << vec2u(16u));
}

fn unpacked(words: vec2u) -> vec4f {
    return vec4f(vec4u(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu, words.y >> 16u));
}
