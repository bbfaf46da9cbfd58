// The log-likelihood by what scores leave of 1, nats: of 1 - s, -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three;
// rounded to 1 / nat_parts.

// Of normal positive numbers: the exponent, and a polynomial for the mantissa in [1, 2), as the CPU takes it. A device's
// own logarithm may be wrong by more than is rounded off.
fn logarithm(a: vec4f) -> vec4f {
    let bits = bitcast<vec4u>(a);
    let exponent = vec4f(bits >> vec4u(23u)) - 127.0;
    let t = bitcast<vec4f>((bits & vec4u(0x7fffffu)) | vec4u(0x3f800000u)) - 1.5;
    var value = vec4f(logarithm_terms[0]);
    for (var k = 1u; k < logarithm_count; k++) { value = value * t + logarithm_terms[k]; }
    return exponent * 0.6931471805599453 + value;
}

fn nats_of(unexplained: vec4f) -> vec4f {
    let clipped = clamp(unexplained, vec4f(), vec4f(1.0));
    var determinant = clipped * (2.0 - clipped);
    if (view_count == 3u) { determinant = clipped * clipped; }
    let nats = -0.5 * logarithm(max(determinant, vec4f(least_determinant)));
    return round(f32(nat_parts) * nats) / f32(nat_parts);
}
