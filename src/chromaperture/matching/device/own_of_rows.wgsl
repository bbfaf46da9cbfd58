// What a pixel costs by itself, and what it is computed from.

struct Own { likelihood: vec4f }

fn own_read(at: u32) -> Own {
    return Own(likelihood[at]);
}

fn own_cost(own: Own) -> vec4f {
    return -own.likelihood;
}
