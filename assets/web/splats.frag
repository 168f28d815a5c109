// Alpha of a splat at a pixel, to be blended from far to near.
in vec2 corner;
flat in float cut;
flat in vec4 colour;
out vec4 blended;

void main() {
  float alpha = min(MAX_ALPHA, colour.a * exp(-0.5 * cut * dot(corner, corner)));
  if (!(alpha >= MIN_ALPHA)) discard;
  blended = vec4(colour.rgb * alpha, alpha);
}
