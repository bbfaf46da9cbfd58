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
