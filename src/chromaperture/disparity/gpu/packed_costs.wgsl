// Path costs of at most the jump in 16 bits.

fn packed(costs: vec4f) -> vec2u {
    return vec2u(pack2x16unorm(costs.xy / jump), pack2x16unorm(costs.zw / jump));
}

fn unpacked(words: vec2u) -> vec4f {
    return jump * vec4f(unpack2x16unorm(words.x), unpack2x16unorm(words.y));
}
