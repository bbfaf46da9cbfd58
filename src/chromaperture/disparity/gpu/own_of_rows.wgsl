// What a pixel costs by itself.

fn own_cost(at: u32) -> vec4f {
    return -likelihood[at];
}
