// Maps that a walk takes together.
alias Maps = vec2f;
