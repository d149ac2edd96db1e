// transfer.bin: a safetensors file, whose header says what each part of the transfer is.

const ARRAYS = { F16: Uint16Array, F32: Float32Array, U16: Uint16Array, U32: Uint32Array };

/** `{about, tensors}` of what `torchprt export --three` wrote; a tensor is `{type, shape, data}`. */
export function parseTransfer(buffer) {
  const length = buffer.byteLength > 8 ? Number(new DataView(buffer).getBigUint64(0, true)) : Infinity;
  if (!(length <= buffer.byteLength - 8)) throw new Error("This is no transfer, or half of one: export it again.");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const about = JSON.parse(header.__metadata__?.torchprt_gpu ?? "null");
  if (about?.format !== 1) {
    throw new Error("This is no transfer for shaders, or a newer one: write it with torchprt export --three.");
  }
  const tensors = {};
  delete header.__metadata__;
  for (const [name, { dtype, shape, data_offsets: [first, end] }] of Object.entries(header)) {
    if (8 + length + end > buffer.byteLength) throw new Error("This is half of a transfer: copy the file again.");
    tensors[name] = { type: dtype, shape, data: new ARRAYS[dtype](buffer.slice(8 + length + first, 8 + length + end)) };
  }
  return { about, tensors };
}
