// The functions of prt.glsl; the text is put here when the module is made.
export const PRT = /* glsl */ `@prt.glsl`;
