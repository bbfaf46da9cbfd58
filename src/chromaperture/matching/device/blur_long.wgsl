// `blur.wgsl` with weights that are read: many.
@group(0) @binding(4) var<storage, read> taps: array<vec4f>;  // of a pixel in the sums of four neighbours

fn sums_of(base: u32, first: i32, length: u32, stride: u32) -> vec4f {
    var sums = vec4f();
    for (var j = 0u; j < span; j++) { sums += taps[j] * pixel_at(base, first + i32(j), length, stride); }
    return sums;
}
