// Light of the channels where they were displaced to, white balanced; of pixels of unknown disparity as it was captured.
// For the eye: linear between pixels, and what another surface hides is not filled in.

fn channel(c: u32, x: f32, y: f32) -> f32 {
    let left = floor(x);
    let top = floor(y);
    let columns = vec2u(inside(i32(left), width), inside(i32(left) + 1i, width));
    let rows = vec2u(inside(i32(top), height), inside(i32(top) + 1i, height)) * width;
    let above = mix(image[3u * (rows.x + columns.x) + c], image[3u * (rows.x + columns.y) + c], x - left);
    let below = mix(image[3u * (rows.y + columns.x) + c], image[3u * (rows.y + columns.y) + c], x - left);
    return mix(above, below, y - top);
}

fn aligned(i: u32) -> vec3f {
    let known = disparity[i] != NAN_BITS;
    let d = select(0.0, bitcast<f32>(disparity[i]), known);
    var rgb = vec3f();
    for (var c = 0u; c < 3u; c++) {
        rgb[c] = balance[c] * channel(c, f32(i % width) + d * shifts[2u * c], f32(i / width) + d * shifts[2u * c + 1u]);
    }
    return rgb;
}
