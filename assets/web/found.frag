// What up to three prompts found: a translucent fill, and a contour with a dark halo.
uniform highp sampler2D blended;
uniform highp sampler2D fieldOfView;
uniform bool isRecorded;
uniform vec2 size;
uniform vec3 colours[3];
uniform float line;
out vec4 colour;

const float FILL = 0.28;
const int AROUND = 8;

vec3 found(vec2 place) {
  vec4 sums = texelFetch(blended, clamp(ivec2(place), ivec2(0), ivec2(size) - 1), 0);
  return sums.a >= MIN_SEEN ? step(0.5 * sums.a, sums.rgb) : vec3(0.0);
}

// One where some, but not all, of the surroundings are found.
vec3 border(vec3 share) {
  return smoothstep(0.0, 0.35, share) * (1.0 - smoothstep(0.65, 1.0, share));
}

void main() {
  vec2 share = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) / size;
  if (isRecorded && texture(fieldOfView, share).r <= 0.5) discard;
  vec3 inside = found(gl_FragCoord.xy), near = vec3(0.0), wide = vec3(0.0);
  for (int k = 0; k < AROUND; k++) {
    float angle = 6.2831853 * (float(k) + 0.3) / float(AROUND);
    vec2 way = line * vec2(cos(angle), sin(angle));
    near += found(gl_FragCoord.xy + way) / float(AROUND);
    wide += found(gl_FragCoord.xy + 2.2 * way) / float(AROUND);
  }
  vec3 contour = border(near), shade = 0.45 * border(wide);
  colour = vec4(0.0);
  for (int k = 0; k < 3; k++) {
    colour = vec4(colours[k], 1.0) * (FILL * inside[k]) + colour * (1.0 - FILL * inside[k]);
    colour = vec4(vec3(0.0), shade[k]) + colour * (1.0 - shade[k]);
    colour = vec4(colours[k], 1.0) * contour[k] + colour * (1.0 - contour[k]);
  }
}
