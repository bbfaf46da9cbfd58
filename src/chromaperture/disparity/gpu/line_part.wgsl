// Lines that share their covariances.

struct Part {
    sides: vec3u,  // near and far texture, whether near comes first
    count: u32,
    values: vec4f,  // powers of near and far, level, least variance
    noise: vec3f,
    members: array<u32, most_lines>,
}
