// Two views, four layers at a time: a value of each view, and the one covariance of the pair.
alias Covariances = vec4f;

fn products(of_views: array<vec4f, 2>) -> Covariances {
    return of_views[0] * of_views[1];
}

fn scores_of(covariances: Covariances, gains: Covariances) -> vec4f {
    return clamp(covariances * gains, vec4f(-1.0), vec4f(1.0));
}
