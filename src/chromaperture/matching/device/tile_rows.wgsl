// Fourier transforms of the rows of all tiles of a photograph without its shading: the low frequencies only. Two rows go
// side by side.

@group(0) @binding(1) var<storage, read> image: array<f32>;  // (h, w, 3)
@group(0) @binding(2) var<storage, read> shading: array<f32>;  // (h, w, 3)
@group(0) @binding(3) var<storage, read> corners: array<i32>;  // (tiles, 2): x and y of a tile's first pixel
@group(0) @binding(4) var<storage, read_write> rows: array<vec2f>;  // (tiles, 3, span, kept)

fn detail(row: u32, place: u32) -> f32 {
    let tile = row / (3u * span);
    let x = mirrored(corners[2u * tile] + i32(place), width);
    let y = mirrored(corners[2u * tile + 1u] + i32(row % span), height);
    let at = (y * width + x) * 3u + row / span % 3u;
    return image[at] - shading[at];
}

fn taken(line: u32, x: u32) -> vec4f {
    return vec4f(detail(2u * line, x), 0.0, detail(2u * line + 1u, x), 0.0);
}

fn given(line: u32, x: u32, value: vec4f) {
    if (x < kept) {
        rows[2u * line * kept + x] = value.xy;
        rows[(2u * line + 1u) * kept + x] = value.zw;
    }
}

@compute @workgroup_size(group_size)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}
