//! Inputs and outputs of a text encoder, read from the model file and checked before anything runs.
//!
//! The file is decoded here, not only by the backend, so that a mix-up can be named in the user's words.

use crate::{
    model_file::{decode, external_files},
    onnx::{GraphProto, ValueInfoProto, data_type},
    settings::{EncoderSettings, Pooling},
};
use prost::bytes::Bytes;
use std::{collections::BTreeSet, path::Path};
use surgtpgs_core::{Error, Result};

/// Kind of values that an input of the model takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Token ids.
    Ids,
    /// 1 for real tokens, 0 for padding.
    Mask,
    /// Sentence number of each token: always 0.
    TokenTypes,
    /// Position of each token.
    Positions,
}

/// One input of the model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// Name in the model.
    pub name: String,
    /// Kind of values that it takes.
    pub role: Role,
}

/// Everything needed to call a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contract {
    /// Inputs, each `[1, tokens]`.
    pub inputs: Vec<Input>,
    /// Number of tokens, if the model takes only this number.
    pub fixed_length: Option<usize>,
    /// Name of the output that is read.
    pub output: String,
    /// Pooling of the output if it has one row per token.
    pub pooling: Pooling,
    /// Rows of the token embedding table, if the graph shows it.
    pub table_rows: Option<usize>,
    /// Files beside the model that hold its weights.
    pub external_files: Vec<String>,
}

impl Contract {
    /// Reads the contract from the model's bytes. `is_clip` says that the tokenizer marks the end of the text
    /// as CLIP's does, which decides the pooling if nothing else does. `path` is only named in errors.
    pub fn read(model: Bytes, settings: &EncoderSettings, is_clip: bool, path: &Path) -> Result<Self> {
        let graph = decode(model, path)?;
        let constants: BTreeSet<&str> = graph.initializer.iter().map(|t| t.name.as_str()).collect();
        let inputs: Vec<_> = graph.input.iter().filter(|i| !constants.contains(i.name.as_str())).collect();
        let roles = input_roles(&inputs, path)?;
        let ids = roles.iter().find(|input| input.role == Role::Ids);
        let ids_info = ids.and_then(|ids| inputs.iter().find(|i| i.name == ids.name));
        let (output, pooling) = choose_output(&graph.output, settings, is_clip, path)?;
        Ok(Self {
            fixed_length: ids_info.and_then(|info| fixed_axis(info, 1)),
            table_rows: ids.and_then(|ids| table_rows(&graph, &ids.name)),
            external_files: external_files(&graph),
            inputs: roles,
            output,
            pooling,
        })
    }

    /// Checks that the model's embedding table has a row for every token of the tokenizer and not many more.
    pub fn check_vocabulary(&self, largest_id: u32, path: &Path) -> Result<()> {
        let hint = "Model and tokenizer.json do not belong together; take both from the same export.";
        match self.table_rows {
            Some(rows) if largest_id as usize >= rows => {
                let what =
                    format!("Largest token id {largest_id} exceeds the model's embedding table ({rows})");
                Err(Error::input_at(path, what, hint))
            }
            // Tables are often padded by a few rows. A table that is larger by a quarter belongs to
            // another vocabulary.
            Some(rows) if rows / 5 * 4 > largest_id as usize + 1 => {
                let what = format!(
                    "The model's embedding table has {rows} rows but tokenizer.json knows only {} tokens",
                    largest_id as usize + 1
                );
                Err(Error::input_at(path, what, hint))
            }
            _ => Ok(()),
        }
    }
}

fn input_roles(inputs: &[&ValueInfoProto], path: &Path) -> Result<Vec<Input>> {
    let is_token_list = |info: &ValueInfoProto| {
        matches!(elem_type(info), data_type::INT64 | data_type::INT32)
            && rank(info).is_none_or(|rank| rank == 2)
    };
    if let Some(image) = inputs.iter().find(|info| rank(info) == Some(4)) {
        let what = format!(
            "The model wants input{} {}; a text encoder takes token ids [1,77]",
            if inputs.len() > 1 { "s" } else { "" },
            inputs.iter().map(|i| describe(i)).collect::<Vec<_>>().join(", ")
        );
        let hint = match inputs.iter().any(|info| is_token_list(info)) {
            true => format!("Export the text half alone, without `{}`.", image.name),
            false => "You may have picked the image encoder.".into(),
        };
        return Err(Error::input_at(path, what, hint));
    }
    let role_of = |info: &ValueInfoProto| match info.name.to_lowercase() {
        _ if !is_token_list(info) => None,
        name if name.contains("mask") => Some(Role::Mask),
        name if name.contains("type") || name.contains("segment") => Some(Role::TokenTypes),
        name if name.contains("position") => Some(Role::Positions),
        name if ["ids", "token", "text"].iter().any(|word| name.contains(word)) || inputs.len() == 1 => {
            Some(Role::Ids)
        }
        _ => None,
    };
    let mut roles: Vec<Input> = Vec::new();
    for info in inputs {
        let role = role_of(info).filter(|role| roles.iter().all(|known| known.role != *role));
        let Some(role) = role else {
            let what = format!(
                "The model wants an input {} that a text encoder does not have; \
                 known are input_ids, attention_mask, token_type_ids and position_ids, integers [1,77]",
                describe(info)
            );
            return Err(Error::input_at(path, what, "Export the text half of the model with these inputs."));
        };
        roles.push(Input { name: info.name.clone(), role });
    }
    if roles.iter().all(|input| input.role != Role::Ids) {
        let what = "The model has no input for token ids; a text encoder takes token ids [1,77]";
        return Err(Error::input_at(
            path,
            what,
            "Export the text half of the model with an input named input_ids.",
        ));
    }
    if let Some(info) = inputs.iter().find(|info| fixed_axis(info, 0).is_some_and(|batch| batch != 1)) {
        let what = format!("The model takes a fixed number of texts at once: {}", describe(info));
        return Err(Error::input_at(path, what, "Export it with a batch of 1 or a batch of any size."));
    }
    Ok(roles)
}

/// Names under which exporters give the finished embedding, in order of preference.
const EMBEDDING_OUTPUTS: &[&str] =
    &["text_embeds", "sentence_embedding", "text_features", "embeddings", "embedding"];

fn choose_output(
    outputs: &[ValueInfoProto],
    settings: &EncoderSettings,
    is_clip: bool,
    path: &Path,
) -> Result<(String, Pooling)> {
    let listed = || outputs.iter().map(describe).collect::<Vec<_>>().join(", ");
    let of_rank = |wanted: usize| {
        let mut fitting =
            outputs.iter().filter(move |o| rank(o) == Some(wanted) && elem_type(o) == data_type::FLOAT);
        let preferred = fitting.clone().find(|o| EMBEDDING_OUTPUTS.contains(&o.name.as_str()));
        preferred.or_else(|| fitting.next()).map(|o| o.name.clone())
    };
    let default_pooling = if is_clip { Pooling::EndOfText } else { Pooling::Mean };
    match &settings.pooling {
        Some(Pooling::Output(name)) => match outputs.iter().any(|o| o.name == *name) {
            true => Ok((name.clone(), Pooling::Output(name.clone()))),
            false => {
                let what = format!("encoder.toml asks for the output `{name}`; the model has {}", listed());
                Err(Error::input_at(path, what, "Correct pooling in encoder.toml."))
            }
        },
        // An output that is already pooled is taken unchanged, even if the file names a pooling.
        given => {
            let pooling = given.clone().unwrap_or(default_pooling);
            let pooled = of_rank(2).map(|name| (name.clone(), Pooling::Output(name)));
            let per_token = of_rank(3).map(|name| (name, pooling.clone()));
            let chosen = if given.is_some() { per_token.or(pooled) } else { pooled.or(per_token) };
            // Some exporters leave out the shape. The first run checks the output then.
            let shapeless = || outputs.iter().find(|o| rank(o).is_none()).map(|o| (o.name.clone(), pooling));
            chosen.or_else(shapeless).ok_or_else(|| {
                let what = format!(
                    "The model gives {}; a text encoder gives float embeddings [1,dim] or hidden states [1,tokens,dim]",
                    listed()
                );
                Error::input_at(path, what, "You may have picked another model.")
            })
        }
    }
}

/// Number of rows of the table that token ids index. Operations that keep the ids are followed.
fn table_rows(graph: &GraphProto, ids: &str) -> Option<usize> {
    const KEEPS_IDS: &[&str] = &["Cast", "Identity", "Reshape", "Flatten", "Squeeze", "Unsqueeze"];
    const KEEPS_ROWS: &[&str] = &["Cast", "Identity", "DequantizeLinear"];
    let mut same_ids = BTreeSet::from([ids]);
    for node in &graph.node {
        let Some(first) = node.input.first().map(String::as_str) else { continue };
        if KEEPS_IDS.contains(&node.op_type.as_str()) && same_ids.contains(first) {
            same_ids.extend(node.output.iter().map(String::as_str));
        }
        let is_lookup = node.op_type == "Gather"
            && node.input.get(1).is_some_and(|index| same_ids.contains(index.as_str()))
            && node.attribute.iter().all(|a| a.name != "axis" || a.i == 0);
        if !is_lookup {
            continue;
        }
        let mut table = first;
        while let Some(maker) = graph.node.iter().find(|n| n.output.iter().any(|o| o == table)) {
            if !KEEPS_ROWS.contains(&maker.op_type.as_str()) {
                return None;
            }
            table = maker.input.first()?;
        }
        let table = graph.initializer.iter().find(|t| t.name == table && t.dims.len() == 2)?;
        return usize::try_from(table.dims[0]).ok();
    }
    None
}

fn elem_type(info: &ValueInfoProto) -> i32 {
    tensor(info).map_or(0, |t| t.elem_type)
}

fn rank(info: &ValueInfoProto) -> Option<usize> {
    Some(tensor(info)?.shape.as_ref()?.dim.len())
}

fn fixed_axis(info: &ValueInfoProto, axis: usize) -> Option<usize> {
    let length = tensor(info)?.shape.as_ref()?.dim.get(axis)?.value?;
    usize::try_from(length).ok().filter(|length| *length > 0)
}

fn tensor(info: &ValueInfoProto) -> Option<&crate::onnx::TensorType> {
    info.ty.as_ref()?.tensor.as_ref()
}

/// Name and shape as in `pixel_values` [1,3,224,224].
fn describe(info: &ValueInfoProto) -> String {
    let axes = tensor(info).and_then(|t| t.shape.as_ref()).map(|shape| {
        let axis = |d: &crate::onnx::Dim| match (d.value, &d.param) {
            (Some(length), _) => length.to_string(),
            (None, Some(name)) if !name.is_empty() => name.clone(),
            _ => "?".into(),
        };
        shape.dim.iter().map(axis).collect::<Vec<_>>().join(",")
    });
    match axes {
        Some(axes) => format!("`{}` [{axes}]", info.name),
        None => format!("`{}`", info.name),
    }
}
