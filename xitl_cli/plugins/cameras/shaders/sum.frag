uniform sampler2D drawn;
uniform float share;
in vec2 place;
out vec4 radiance;

void main() {
    radiance = share * texture(drawn, place);
}
