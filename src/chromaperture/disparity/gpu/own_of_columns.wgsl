// What a pixel costs by itself, and a share of what comes along its row.

@group(0) @binding(4) var<storage, read> rightward: array<vec2u>;
@group(0) @binding(5) var<storage, read> leftward: array<vec2u>;

fn own_cost(at: u32) -> vec4f {
    return row_share / row_parts * (unpacked(rightward[at]) + unpacked(leftward[at])) - likelihood[at];
}
