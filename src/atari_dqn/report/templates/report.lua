-- What Markdown alone does not say, for the page (HTML) and for paper (Typst).

local paper = FORMAT == "typst"

local function has(element, class) return element.classes:includes(class) end

-- What code has computed writes a minus sign as a hyphen: "-12.8 (-16.5 to -9.2)".
local function minus(word)
  word.text = word.text:gsub("^(%(?)-(%d)", "%1−%2")
  return word
end

local function wrapped(open, blocks, close)
  local result = { pandoc.RawBlock("typst", open) }
  for _, block in ipairs(blocks) do table.insert(result, block) end
  table.insert(result, pandoc.RawBlock("typst", close))
  return result
end

local function quoted(text) return '"' .. text:gsub("\\", "\\\\"):gsub('"', '\\"') .. '"' end

-- "84 × 84" stays on one line.
local function times(inlines)
  for place, inline in ipairs(inlines) do
    if inline.t == "Str" and inline.text == "×" then
      for _, beside in ipairs({ place - 1, place + 1 }) do
        if inlines[beside] and inlines[beside].t == "Space" then inlines[beside] = pandoc.Str("\u{a0}") end
      end
    end
  end
  return inlines
end

-- A browser may break a line between a formula and its comma.
local function glue(inlines)
  inlines = times(inlines)
  local result, open = {}, nil
  for _, inline in ipairs(inlines) do
    local formula = inline.t == "Math" and inline.mathtype == "InlineMath"
    if open and inline.t ~= "Space" and inline.t ~= "SoftBreak" and inline.t ~= "LineBreak" then
      open.content:insert(inline)
    elseif formula then
      open = pandoc.Span({ inline }, { class = "nobreak" })
      table.insert(result, open)
    else
      open = nil
      table.insert(result, inline)
    end
  end
  return pandoc.Inlines(result)
end

local function span(element)
  if has(element, paper and "page" or "paper") then return {} end -- meant for the other medium
  if paper and has(element, "absent") then -- a bare label would be that of what stands before it
    return pandoc.RawInline("typst", "#metadata(none) <" .. element.identifier .. ">")
  end
  if not has(element, "equation") then return nil end
  if paper then
    return { pandoc.RawInline("typst", "#numbered["), element, pandoc.RawInline("typst", "]") }
  end
  local number = pandoc.Span("(" .. element.attributes.number .. ")", { class = "number" })
  element.attributes.number = nil
  element.content = { pandoc.Span(element.content, { class = "formula" }), number }
  return element
end

local floats = false -- whether anything may still do so, since the section began

-- Figures on paper: with text alternatives, which pandoc leaves out. The first of a section floats
-- to where it is near its text. Further ones go to the top: at the bottom of a page, they would
-- stand below the next section's heading.
local function on_paper(file, alt, caption, label, width)
  local placement = floats and "top" or "auto"
  floats = true
  local open = "#figure(placement: " .. placement .. ", image(" .. quoted(file) .. ", width: "
    .. (width or "100%") .. ", alt: " .. quoted(alt) .. "), caption: ["
  return wrapped(open, caption, "]) <" .. label .. ">")
end

local function figure(element)
  if not paper then return nil end
  local image
  element:walk({ Image = function(found) image = found end })
  local alt = pandoc.utils.stringify(image.caption)
  return on_paper(image.src, alt, element.caption.long, element.identifier)
end

local TALLEST = 0.66 -- of the text's width: a page holds two strips of pictures that are no taller

local function strip_width(file)
  local _, bytes = pandoc.mediabag.fetch(file)
  local size = pandoc.image.size(bytes)
  return string.format("%.1f%%", 100 * math.min(1, TALLEST * size.width / size.height))
end

-- A video (report/templates/section): the film for the page, a strip of its pictures for paper.
local function video(div)
  local caption = { pandoc.Plain(div.content[#div.content].content) }
  if paper then
    local strip = div.attributes.strip
    return on_paper(strip, div.attributes.alt, caption, div.identifier, strip_width(strip))
  end
  local attributes = pandoc.Attr(div.identifier, { "video" })
  return pandoc.Figure({ div.content[1] }, { long = caption }, attributes)
end

local SIGNS = { yes = "✓", no = "✗", unclear = "≈", open = "○", untested = "–" }

-- A board of verdicts: what their colours say is also said in a word.
local function tile(div)
  for class, sign in pairs(SIGNS) do
    if has(div, class) then
      local word = sign .. " " .. div.attributes.verdict
      if paper then
        local open = "#tile(" .. quoted(class) .. ", " .. quoted(word) .. ")["
        return pandoc.Div(wrapped(open, div.content, "]"))
      end
      div.content:insert(1, pandoc.Para({ pandoc.Span(word, { class = "verdict" }) }))
    end
  end
  return div
end

local function board(content)
  local result = { pandoc.RawBlock("typst", "#board(") }
  for _, cell in ipairs(content) do
    for _, block in ipairs(wrapped("[", cell.content, "],")) do table.insert(result, block) end
  end
  table.insert(result, pandoc.RawBlock("typst", ")"))
  return result
end

local function division(div)
  if has(div, "video") then return video(div) end
  if has(div, "tile") then return tile(div) end
  if not paper then return nil end
  if has(div, "badge") then
    return wrapped(has(div, "partial") and "#badge(warn)[" or "#badge(accent)[", div.content, "]")
  elseif has(div, "absent") then
    return wrapped("#absent[", div.content, "] <" .. div.identifier .. ">")
  elseif has(div, "board") then
    return board(div.content)
  end
end

-- A listing may be broken between pages where a new definition begins, and only there.
local function listing(block)
  local parts = pandoc.Blocks({})
  for part in (block.text:gsub("\n\n+(%S)", "\0%1") .. "\0"):gmatch("(.-)\0") do
    parts:insert(pandoc.CodeBlock(part, block.attr))
  end
  return parts
end

local SHORT = 9 -- rows; such a table stays in its place, where it leaves no hole worth mentioning
local WHOLE = 12 -- rows; a longer table may be broken between pages

local function rows(element)
  local count = 0
  for _, body in ipairs(element.bodies) do count = count + #body.body end
  return count
end

local after_long = false -- what floats to the top, after a broken table, would stand within that

-- A name may be broken after its underscores, rather than overlap the next column.
local function breakable(code)
  code.text = code.text:gsub("_", "_\u{200b}")
  return code
end

-- An agent's name stands once over its rows: repeated, it would take three lines of each.
local function name_once(element)
  local title = element.head.rows[1]
  if not title or pandoc.utils.stringify(title.cells[1].contents) ~= "agent" then return end
  for _, body in ipairs(element.bodies) do
    local above
    for _, row in ipairs(body.body) do
      local name = pandoc.utils.stringify(row.cells[1].contents)
      if name == above then row.cells[1].contents = {} end
      above = name
    end
  end
end

local function on_paper_table(element)
  element = element:walk({ Code = breakable })
  name_once(element)
  if rows(element) <= SHORT then return wrapped("#whole[", { element }, "]") end
  if rows(element) > WHOLE then
    after_long = true
    if not floats then return element end
    floats = false -- what still does would come to stand within it
    return pandoc.Blocks({ pandoc.RawBlock("typst", "#place.flush()"), element })
  end
  floats = true
  return wrapped(after_long and "#floating(to: bottom)[" or "#floating[", { element }, "]")
end

local function heading(element)
  after_long = false
  if element.level <= 2 then floats = false end -- none leaves its section (report.typ)
end

-- The abstract stands before the contents, wherever the text has it.
local function document(whole)
  local blocks, appendices = pandoc.Blocks({}), false
  for _, block in ipairs(whole.blocks) do
    if block.t == "Div" and has(block, "abstract") then
      whole.meta.abstract = pandoc.MetaBlocks(block.content)
    else
      if paper and block.t == "Header" and has(block, "appendix") and not appendices then
        blocks:insert(pandoc.RawBlock("typst", "#show: appendices"))
        appendices = true
      end
      blocks:insert(block)
    end
  end
  whole.blocks = blocks
  return whole
end

local first = { Str = minus, Span = span, Div = division, Pandoc = document }
if paper then
  first.Figure, first.Table, first.CodeBlock, first.Inlines = figure, on_paper_table, listing, times
  first.Header = heading
else
  first.Inlines = glue
end
return { first }
