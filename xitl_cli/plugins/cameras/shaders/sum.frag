// Adds light in proportion: the square of an image's value is nearly that.
uniform sampler2D drawn;
uniform float share;
in vec2 place;
out vec4 value;

void main() {
    vec4 shown = texture(drawn, place);
    value = share * shown * shown;
}
