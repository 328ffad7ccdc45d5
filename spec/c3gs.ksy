# SPEC.md chapter 5 for Kaitai Struct. tests/spec compares the fields, types and docs with its syntax tables.
meta:
  id: c3gs
  title: "C3GS: a bitstream for learned 3D Gaussian scenes"
  file-extension: c3gs
  xref:
    mime: model/vnd.c3gs
  license: Apache-2.0
  endian: le
doc: |
  Format version 0. Numbers of type f16 are their bits. The coded symbols are words and raw bits here: SPEC.md
  chapters 7 and 8 decode them. The values of weights are bytes. A damaged ancillary section, which a decoder ignores,
  is an error here.
seq:
  - id: prologue
    type: prologue
  - id: header
    type: header
    size: prologue.header_length
  - id: sections
    type: section(_index)
    repeat: expr
    repeat-expr: header.section_count
types:
  section:
    doc: "A section and its padding."
    params:
      - id: number
        type: u2
    seq:
      - id: content
        size: entry.length
        type:
          switch-on: entry.type
          cases:
            '"FRAM"': frame
            '"WGTS"': weights
            '"PLNS"': planes
            '"INDX"': index(entry.mode)
            '"DATA"': data
            '"mETa"': metadata
            '"cAMs"': cameras
      - id: padding
        size: (4 - entry.length % 4) % 4
    instances:
      entry:
        value: _root.header.directory[number]
  weights:
    seq:
      - id: scales
        type: weight_scales
      - id: values
        size-eos: true
  planes:
    seq:
      - id: table
        type: plane_table
      - id: substreams
        type: padded(table.length[_index], _root.header.plane_lanes_log2)
        repeat: expr
        repeat-expr: 5
  index:
    params:
      - id: mode
        type: u1
    seq:
      - id: mask_model
        type: mask_model
      - id: position_model
        type: position_model
        if: mode == 1
      - id: chunks
        type: chunk_entry
        repeat: expr
        repeat-expr: _root.header.chunk_count
  data:
    seq:
      - id: chunks
        type: whole_chunk
        repeat: eos
  whole_chunk:
    seq:
      - id: head
        type: chunk
      - id: positions
        type: positions(head.position_length)
        if: head.position_form == 0
      - id: packed_positions
        type: padded(head.position_length, _root.header.mask_lanes_log2)
        if: head.position_form == 1
      - id: masks
        type: padded(head.mask_length, _root.header.mask_lanes_log2)
      - id: attributes
        type: padded(head.attribute_length, _root.header.attribute_lanes_log2)
  positions:
    params:
      - id: length
        type: u4
    seq:
      - id: coordinate
        type: u2
        repeat: expr
        repeat-expr: length / 2
      - id: padding
        size: (4 - length % 4) % 4
  padded:
    params:
      - id: length
        type: u4
      - id: lanes_log2
        type: u1
    seq:
      - id: substream
        size: length
        type: substream(lanes_log2)
      - id: padding
        size: (4 - length % 4) % 4
  prologue:
    seq:
      - id: signature
        contents: [0x89, 0x43, 0x33, 0x47, 0x53, 0x0d, 0x0a, 0x1a]
        doc: "89 43 33 47 53 0D 0A 1A"
      - id: major
        type: u2
        doc: "major version"
      - id: minor
        type: u2
        doc: "minor version"
      - id: header_length
        type: u4
        doc: "bytes of the header, a multiple of 4"
      - id: prologue_crc
        type: u4
        doc: "CRC-32 of the 16 bytes before it"
  header:
    seq:
      - id: profile
        type: u1
        doc: "0 Tiny, 1 Main (11.1)"
      - id: level
        type: u1
        doc: "level of the profile (11.2)"
      - id: section_count
        type: u2
        doc: "entries of the directory"
      - id: anchor_count
        type: u4
        doc: "N"
      - id: chunk_count
        type: u4
        doc: "C"
      - id: chunk_size
        type: u4
        doc: "most anchors of a chunk"
      - id: plane_lanes_log2
        type: u1
        doc: "base-2 logarithm of the lanes of substreams of planes"
      - id: mask_lanes_log2
        type: u1
        doc: "the same for substreams of masks and of positions"
      - id: attribute_lanes_log2
        type: u1
        doc: "the same for substreams of attributes and of weights"
      - id: reserved
        type: u1
        doc: "reserved: 0"
      - id: base_step
        type: f4
        repeat: expr
        repeat-expr: 3
        doc: "steps of features, scalings and offsets at step index 32"
      - id: position_grid
        type: position_grid
        doc: "5.4"
      - id: render_info
        type: render_info
        doc: "5.5"
      - id: dimensions
        type: dimensions
        doc: "5.3"
      - id: directory
        type: directory_entry
        repeat: expr
        repeat-expr: section_count
        doc: "5.6"
      - id: further
        size: _io.size - _io.pos - 4
      - id: header_crc
        type: u4
        doc: "CRC-32 of the header's bytes before it"
  dimensions:
    seq:
      - id: offset_count
        type: u1
        doc: "K"
      - id: plane_channels
        type: u1
        doc: "ch; 0 if there are no planes"
      - id: frequency_count
        type: u1
        doc: "L; 0 if there is no positional encoding"
      - id: slice_count
        type: u1
        doc: "slices of the features"
      - id: hyper_layers
        type: u1
        doc: "hidden layers of F_h"
      - id: sarm_layers
        type: u1
        doc: "hidden layers of SARM"
      - id: carm_layers
        type: u1
        doc: "hidden layers of each network of CARM"
      - id: view_inputs
        type: u1
        doc: "inputs of each rendering network in addition to the features"
      - id: colour_outputs
        type: u1
        doc: "outputs of the colour network for each offset"
      - id: reserved
        type: u1
        doc: "reserved: 0"
      - id: plane_size
        type: u2
        doc: "B; 0 if there are no planes"
      - id: render_width
        type: u2
        doc: "width of the one hidden layer of each rendering network"
      - id: hyper_width
        type: u2
        repeat: expr
        repeat-expr: hyper_layers
        doc: "widths of the hidden layers of F_h"
      - id: sarm_width
        type: u2
        repeat: expr
        repeat-expr: sarm_layers
        doc: "widths of the hidden layers of SARM"
      - id: carm_width
        type: u2
        repeat: expr
        repeat-expr: carm_layers
        doc: "widths of the hidden layers of CARM"
      - id: slice_width
        type: u1
        repeat: expr
        repeat-expr: slice_count
        doc: "channels of each slice; their sum is F"
      - id: padding
        size: (4 - _io.pos % 4) % 4
        doc: "zeros"
  position_grid:
    seq:
      - id: origin
        type: s8
        repeat: expr
        repeat-expr: 3
        doc: "origin, in 2^(scale_exponent - 24)"
      - id: scale_mantissa
        type: u2
        doc: "S"
      - id: scale_exponent
        type: s1
        doc: "E"
      - id: reserved
        type: u1
        doc: "reserved: 0"
  render_info:
    seq:
      - id: background
        type: u1
        repeat: expr
        repeat-expr: 3
        doc: "red, green, blue where there is no Gaussian, 255 for 1"
      - id: up_axis
        type: u1
        doc: "0 to 5: +x, -x, +y, -y, +z, -z points up"
      - id: near_plane
        type: f4
        doc: "depth in world units at or below which nothing is drawn"
      - id: distance_unit
        type: f4
        doc: "world distance that counts as 1 (14.3)"
      - id: alpha_max
        type: f4
        doc: "largest alpha of one Gaussian in one pixel"
      - id: low_pass
        type: f4
        doc: "square pixels, added to both variances (14.4)"
      - id: colour_primaries
        type: u1
        doc: "colour primaries of ITU-T H.273 (6.5)"
      - id: transfer_characteristics
        type: u1
        doc: "transfer characteristics of ITU-T H.273 (6.5)"
      - id: render_model
        type: u1
        doc: "how the scene is drawn (6.5)"
      - id: reserved
        type: u1
        doc: "reserved: 0"
  directory_entry:
    seq:
      - id: type
        size: 4
        type: str
        encoding: ASCII
        doc: "four letters (12.1)"
      - id: mode
        type: u1
        doc: "coding mode of the section"
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 3
        doc: "reserved: 0"
      - id: length
        type: u8
        doc: "bytes, without padding behind it"
      - id: crc
        type: u4
        doc: "CRC-32 of the section; 0 for DATA (6.6)"
  frame:
    seq:
      - id: matrix
        type: s4
        repeat: expr
        repeat-expr: 9
        doc: "A, row by row; row 0 is the first principal component"
      - id: translation
        type: s8
        repeat: expr
        repeat-expr: 3
        doc: "T"
      - id: shift
        type: u1
        repeat: expr
        repeat-expr: 3
        doc: "s, for each row"
      - id: reserved
        type: u1
        doc: "reserved: 0"
      - id: low
        type: s4
        repeat: expr
        repeat-expr: 3
        doc: "lower bound of each contracted coordinate"
      - id: high
        type: s4
        repeat: expr
        repeat-expr: 3
        doc: "upper bound of each contracted coordinate"
  weight_scales:
    seq:
      - id: plane_shift
        type: u1
        doc: "scale of the plane query (7.5.4); 0 if there are no planes"
      - id: carm_input_count
        type: u1
        doc: "F less the width of the last slice"
      - id: carm_shift
        type: u1
        repeat: expr
        repeat-expr: carm_input_count
        doc: "scale of each input of CARM (7.9)"
      - id: padding
        size: (4 - _io.pos % 4) % 4
        doc: "zeros"
  layer_model:
    seq:
      - id: form
        type: u1
        doc: "0 raw, 1 packed"
      - id: exponent_scale
        type: u1
        doc: "scale index of the rows' grid exponents, less SCALE_MIN"
      - id: exponent
        type: s2
        doc: "grid exponent of the first row that is not all zero (7.13)"
      - id: weight_scale
        type: u1
        doc: "scale index of the weights, less SCALE_MIN"
      - id: bias_scale
        type: u1
        doc: "scale index of the biases, less SCALE_MIN"
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 2
        doc: "reserved: 0"
  plane_table:
    seq:
      - id: length
        type: u4
        repeat: expr
        repeat-expr: 5
        doc: "bytes of each substream, without its padding"
  mask_model:
    seq:
      - id: frequency
        type: u2
        repeat: expr
        repeat-expr: _root.header.dimensions.offset_count * (_root.header.dimensions.offset_count + 1) / 2
        doc: "frequencies of \"kept\" (7.6)"
      - id: padding
        size: (4 - _io.pos % 4) % 4
        doc: "zeros"
  position_model:
    seq:
      - id: cell_shift
        type: u1
        doc: "what a cell is (7.12)"
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 3
        doc: "reserved: 0"
      - id: frequency
        type: u2
        repeat: expr
        repeat-expr: 288
        doc: "POSITION_MODELS models of 16 frequencies each (7.12)"
  chunk_entry:
    seq:
      - id: length
        type: u4
        doc: "bytes of the chunk, a multiple of 4"
      - id: crc
        type: u4
        doc: "CRC-32 of the chunk's bytes"
      - id: anchor_count
        type: u4
        doc: "anchors of the chunk"
      - id: kept_count
        type: u4
        doc: "kept offsets of the chunk, which gives at most so many Gaussians"
      - id: low
        type: u2
        repeat: expr
        repeat-expr: 3
        doc: "for each axis the least coordinate of the chunk's positions, before the position grid"
      - id: high
        type: u2
        repeat: expr
        repeat-expr: 3
        doc: "for each axis the largest one"
  chunk:
    seq:
      - id: position_length
        type: u4
        doc: "bytes of the positions, without their padding"
      - id: mask_length
        type: u4
        doc: "bytes of the masks, without their padding"
      - id: attribute_length
        type: u4
        doc: "bytes of the attributes, without their padding"
      - id: position_form
        type: u1
        doc: "0 raw, 1 packed"
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 3
        doc: "reserved: 0"
  substream:
    params:
      - id: lanes_log2
        type: u1
    seq:
      - id: symbol_crc
        type: u4
        doc: "CRC-32 of the decoded symbols (8.8)"
      - id: word_count
        type: u4
        doc: "words"
      - id: state
        type: u4
        repeat: expr
        repeat-expr: 1 << lanes_log2
        doc: "initial state of each lane"
      - id: word
        type: u2
        repeat: expr
        repeat-expr: word_count
        doc: "words"
      - id: raw
        size-eos: true
        doc: "raw bits (8.6)"
  metadata:
    seq:
      - id: count
        type: u2
        doc: "entries"
      - id: reserved
        type: u2
        doc: "reserved: 0"
      - id: items
        type: entry
        repeat: expr
        repeat-expr: count
  entry:
    seq:
      - id: key_length
        type: u2
        doc: "bytes of the key"
      - id: value_length
        type: u2
        doc: "bytes of the value"
      - id: key
        size: key_length
        type: str
        encoding: ASCII
        doc: "ASCII: small letters, digits, `.`, `_` and `-`"
      - id: value
        size: value_length
        type: str
        encoding: UTF-8
        doc: "UTF-8"
      - id: padding
        size: (4 - _io.pos % 4) % 4
        doc: "zeros"
  cameras:
    seq:
      - id: count
        type: u2
        doc: "cameras"
      - id: reserved
        type: u2
        doc: "reserved: 0"
      - id: items
        type: camera
        repeat: expr
        repeat-expr: count
  camera:
    seq:
      - id: length
        type: u4
        doc: "bytes of the camera that follow this field"
      - id: width
        type: u4
        doc: "width of the image in pixels"
      - id: height
        type: u4
        doc: "height of the image in pixels"
      - id: focal
        type: f4
        repeat: expr
        repeat-expr: 2
        doc: "focal lengths in pixels"
      - id: principal_point
        type: f4
        repeat: expr
        repeat-expr: 2
        doc: "principal point in pixels"
      - id: rotation
        type: f4
        repeat: expr
        repeat-expr: 4
        doc: "quaternion w, x, y, z from world to camera"
      - id: translation
        type: f4
        repeat: expr
        repeat-expr: 3
        doc: "translation from world to camera"
      - id: name_length
        type: u4
        doc: "bytes of the name"
      - id: name
        size: name_length
        type: str
        encoding: UTF-8
        doc: "UTF-8"
      - id: padding
        size: (4 - _io.pos % 4) % 4
        doc: "zeros"
      - id: further
        size: length - 56 - (name_length + 3) / 4 * 4
