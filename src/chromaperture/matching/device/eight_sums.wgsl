// Sums of a filter of P and Q at eight neighbours, whose pixels overlap: the first four and the others, and the weights of
// what is read.

struct Sums { near: vec4f, far: vec4f, near_p: vec4f, far_p: vec4f, near_q: vec4f, far_q: vec4f }

fn added(sums: Sums, tap: f32, here: vec2f) -> Sums {
    var next = sums;
    next.far = vec4f(sums.near.w, sums.far.xyz);
    next.near = vec4f(tap, sums.near.xyz);
    next.near_p += next.near * here.x;
    next.far_p += next.far * here.x;
    next.near_q += next.near * here.y;
    next.far_q += next.far * here.y;
    return next;
}
