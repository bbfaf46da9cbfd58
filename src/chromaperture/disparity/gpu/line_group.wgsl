// What a line, and the lines that share its sides, are known by.

struct Line {
    noise: vec3f,
    light: f32,  // mean of its samples
    ends: vec2f,  // sum of the squared deviations of the first samples and of the last
    key: u32,  // of its sides, `unheard` where it runs along its border
}

const unheard = 0xffffffffu;

// Near and far texture, and whether near comes first, of a key.
fn sides_of(key: u32) -> vec3u {
    let far = key % layers;
    let near = key / layers % layers;
    let node = key / (layers * layers) % nodes;
    let order = key / (layers * layers * nodes);
    let first = ((order / 2u) * nodes + node) * layers;
    return vec3u(first + near, first + far, order % 2u);
}
