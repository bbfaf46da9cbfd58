// Maps that a walk takes together.
alias Maps = f32;
