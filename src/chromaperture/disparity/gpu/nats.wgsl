// The log-likelihood of scores, nats: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three.

fn nats_of(found: vec4f) -> vec4f {
    let clipped = clamp(found, vec4f(), vec4f(1.0));
    var determinant = (1.0 - clipped) * (1.0 + clipped);
    if (view_count == 3u) { determinant = (1.0 - clipped) * (1.0 - clipped); }
    return -0.5 * log(max(determinant, vec4f(least_determinant)));
}
