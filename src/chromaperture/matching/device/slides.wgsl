// Four layers that are 1 px apart along a walk read a pixel each, and a step further on all but one of these again. A
// slide is what they are apart along the walk: 1 or -1 px, 0 where they are not.

// The four, one step further on: those before them, and the pixel that is new; all four where they do not slide.
fn slid(before: vec4f, next: vec4f, slide: f32) -> vec4f {
    if (slide == 0.0) { return next; }
    return select(vec4f(next.x, before.xyz), vec4f(before.yzw, next.w), slide > 0.0);
}

// What a window holds where it begins behind the last of all samples, from which on all is even: of covariances `state`
// up to there, `apart` the product of the next deviations, and `own` covariances of the samples themselves.
const of_state = decay / (1.0 + decay);
const of_apart = 1.0 / ((1.0 - decay) * (1.0 + decay) * (1.0 + decay));
const of_own = 1.0 / (1.0 + decay);
