// Two views, four layers: their variances, then their covariance.

fn spread(apart: array<vec4f, 2>) -> array<vec4f, 3> {
    return array(apart[0] * apart[0], apart[1] * apart[1], apart[0] * apart[1]);
}

fn score_of(spreads: array<vec4f, 3>, gains: array<vec4f, 2>) -> vec4f {
    return scores_of(spreads[2], products(gains));
}
