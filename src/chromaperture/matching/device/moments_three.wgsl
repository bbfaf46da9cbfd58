// Three views, four layers: their variances, then the covariances of the pairs 01, 02, 12.

fn spread(apart: array<vec4f, 3>) -> array<vec4f, 6> {
    let squares = array(apart[0] * apart[0], apart[1] * apart[1], apart[2] * apart[2]);
    return array(squares[0], squares[1], squares[2], apart[0] * apart[1], apart[0] * apart[2], apart[1] * apart[2]);
}

fn score_of(spreads: array<vec4f, 6>, gains: array<vec4f, 3>) -> vec4f {
    return scores_of(mat3x4f(spreads[3], spreads[4], spreads[5]), products(gains));
}
