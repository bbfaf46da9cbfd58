// `blur.wgsl` with weights that are constants: `taps`, of a pixel in the sums of four neighbours.
fn sums_of(base: u32, first: i32, length: u32, stride: u32) -> vec4f {
    var sums = vec4f();
    for (var j = 0u; j < span; j++) {  // unrolled
        let weights = vec4f(taps[4u * j], taps[4u * j + 1u], taps[4u * j + 2u], taps[4u * j + 3u]);
        sums += weights * pixel_at(base, first + i32(j), length, stride);
    }
    return sums;
}
